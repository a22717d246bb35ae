#include "policy_server/server/plugin_jail.h"

#include <pwd.h>
#include <unistd.h>

#include <cstdint>
#include <optional>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::server {
namespace {

constexpr char kNobody[] = "nobody";

std::optional<inspect::JailIds> Find(const std::string& user) {
  uint32_t number = 0;
  if (absl::SimpleAtoi(user, &number)) return inspect::JailIds{.uid = number, .gid = number};
  const passwd* entry = getpwnam(user.c_str());  // before there are other threads
  if (entry == nullptr) return std::nullopt;
  return inspect::JailIds{.uid = entry->pw_uid, .gid = entry->pw_gid};
}

// Nothing if we are not root.
absl::StatusOr<std::optional<inspect::JailIds>> ChooseUser(const std::string& configured,
                                                           std::vector<std::string>& missing) {
  if (geteuid() != 0) {
    missing.push_back("not root: plugins and scans run as the server's own user");
    return std::optional<inspect::JailIds>();
  }
  std::optional<inspect::JailIds> ids = Find(configured.empty() ? kPluginUser : configured);
  if (!ids && configured.empty()) {
    ids = Find(kNobody);
    if (ids) {
      missing.push_back(absl::StrCat("no user `", kPluginUser, "`: plugins and scans run as `",
                                     kNobody, "`, which others may, too"));
    }
  }
  if (!ids || ids->uid == 0) {
    return absl::InvalidArgumentError(absl::StrCat("plugins.user: there is no user `",
                                                   configured.empty() ? kPluginUser : configured,
                                                   "` other than root"));
  }
  return ids;
}

// One server has one store; 32-bit FNV-1a.
std::string CgroupName(const std::string& store_path) {
  uint32_t hash = 2'166'136'261u;
  for (const char byte : store_path) hash = (hash ^ static_cast<unsigned char>(byte)) * 16'777'619u;
  return absl::StrFormat("rips-inspect-%08x", hash);
}

}  // namespace

absl::StatusOr<PluginJail> MakePluginJail(const ServerConfig& config) {
  PluginJail jail;
  RIPS_ASSIGN_OR_RETURN(jail.containment.ids, ChooseUser(config.plugin_user, jail.missing));
  jail.containment.helpers = config.plugin_helpers;
  jail.containment.readable = config.plugin_readable;
  int left_behind = 0;
  auto cgroups = RunCgroups::Open("", CgroupName(config.store_path), &left_behind);
  if (left_behind > 0) {
    LogWarning("killed plugins left by a previous server", {{"processes", left_behind}});
  }
  if (cgroups.ok()) jail.cgroups = *std::move(cgroups);
  jail.containment.cgroups = jail.cgroups.get();
  const auto probed = inspect::ProbeContainment(jail.containment);
  if (probed.ok()) {
    jail.missing.insert(jail.missing.end(), probed->begin(), probed->end());
  } else {
    jail.missing.push_back(
        absl::StrCat("no plugin and no scan can run: ", probed.status().message()));
  }
  return jail;
}

}  // namespace rips::server
