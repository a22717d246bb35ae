#include "tests/support/dds_peer/lawless.h"

#include <dlfcn.h>

#include "absl/strings/string_view.h"
#include "dds/ddsrt/dynlib.h"
#include "dds/security/dds_security_api_access_control.h"

struct ddsi_domaingv;

namespace rips::dds_peer {
namespace {

bool ignoring = false;
using PluginInit = int (*)(const char* argument, void** context, ddsi_domaingv* gv);
PluginInit init_of_plugin = nullptr;

// In place of the plugin's own.
int Init(const char* argument, void** context, ddsi_domaingv* gv) {
  const int result = init_of_plugin(argument, context, gv);
  if (result != 0) return result;
  auto* const access = static_cast<dds_security_access_control*>(*context);
  access->check_create_topic = [](auto...) -> DDS_Security_boolean { return true; };
  access->check_create_datawriter = [](auto...) -> DDS_Security_boolean { return true; };
  access->check_create_datareader = [](auto...) -> DDS_Security_boolean { return true; };
  return result;
}

}  // namespace

void IgnoreOwnPermissions() { ignoring = true; }

}  // namespace rips::dds_peer

// In place of the middleware's: with it it finds the functions of its security plugins.
extern "C" dds_return_t ddsrt_dlsym(ddsrt_dynlib_t handle, const char* symbol, void** address) {
  using Find = dds_return_t (*)(ddsrt_dynlib_t, const char*, void**);
  static const auto find = reinterpret_cast<Find>(dlsym(RTLD_NEXT, "ddsrt_dlsym"));
  const dds_return_t result = find(handle, symbol, address);
  using namespace rips::dds_peer;  // NOLINT: what stands above
  if (ignoring && result == DDS_RETCODE_OK && absl::string_view(symbol) == "init_access_control") {
    init_of_plugin = reinterpret_cast<PluginInit>(*address);
    *address = reinterpret_cast<void*>(&Init);
  }
  return result;
}
