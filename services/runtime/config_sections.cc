#include "services/runtime/config_sections.h"

#include <algorithm>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/ids.h"
#include "services/runtime/atomic_file.h"

namespace rips {
namespace {

constexpr uint32_t kDomainMax = 230;

}  // namespace

void ReadName(const ConfigSection& section, absl::string_view key, absl::string_view what,
              std::string* value) {
  section.Required(key, value);
  if (value->empty()) return;  // reported
  if (const absl::Status valid = ValidateName(what, *value); !valid.ok()) {
    section.Problem(key, valid.message());
  }
}

void ReadPath(const ConfigSection& section, absl::string_view key, std::string* value) {
  section.Required(key, value);
  if (!value->empty() && value->front() != '/') {
    section.Problem(key, absl::StrCat("`", key, "` is `", *value, "`; write an absolute path"));
  }
}

TlsFiles ReadTls(const ConfigSection& root) {
  TlsFiles files;
  const ConfigSection tls = root.RequiredSection("tls");
  ReadPath(tls, "ca", &files.ca);
  ReadPath(tls, "cert", &files.cert);
  ReadPath(tls, "key", &files.key);
  tls.Optional("crl", &files.crl);
  if (!files.crl.empty() && files.crl.front() != '/') {
    tls.Problem("crl", absl::StrCat("`crl` is `", files.crl, "`; write an absolute path"));
  }
  return files;
}

DdsSettings ReadDds(const ConfigSection& root) {
  DdsSettings settings;
  const ConfigSection dds = root.OptionalSection("dds");
  dds.Optional("domain", &settings.domain, {0, kDomainMax});
  dds.Optional("interface", &settings.interface);
  dds.Optional("announce", &settings.announce);
  dds.OptionalEnum<uint32_t>("gid_bytes", &settings.gid_bytes,
                             {{"auto", 0}, {"16", 16}, {"24", 24}});
  const ConfigSection security = dds.OptionalSection("security");
  if (!security.present()) return settings;
  ReadPath(security, "keystore", &settings.keystore);
  security.Required("enclave", &settings.enclave);
  if (!settings.enclave.empty() && settings.enclave.front() != '/') {
    security.Problem("enclave", "`enclave` must begin with `/`");
  }
  return settings;
}

void ReadCount(const ConfigSection& section, absl::string_view key, size_t max, size_t* value) {
  auto wide = static_cast<int64_t>(*value);
  section.Optional(key, &wide, {1, static_cast<int64_t>(max)});
  *value = static_cast<size_t>(wide);
}

bool IsHostPort(absl::string_view text) {
  const size_t colon = text.rfind(':');
  if (colon == absl::string_view::npos || colon == 0) return false;
  const absl::string_view host = text.substr(0, colon);
  const absl::string_view port = text.substr(colon + 1);
  int number = 0;
  if (port.empty() || port.size() > 5 ||
      port.find_first_not_of("0123456789") != absl::string_view::npos ||
      !absl::SimpleAtoi(port, &number) || number > 65535) {
    return false;
  }
  const auto only = [](absl::string_view part, absl::string_view allowed) {
    return !part.empty() && part.find_first_not_of(allowed) == absl::string_view::npos;
  };
  if (host.front() == '[') {
    return host.back() == ']' && only(host.substr(1, host.size() - 2), "0123456789abcdefABCDEF:.");
  }
  return only(host, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_");
}

absl::StatusOr<std::string> ReadConfigFile(const std::string& path) {
  return ReadFile(path, kConfigBytesMax);
}

}  // namespace rips
