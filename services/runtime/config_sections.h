// Sections that several daemons' configuration files share, and reading such a file.
#ifndef RIPS_SERVICES_RUNTIME_CONFIG_SECTIONS_H_
#define RIPS_SERVICES_RUNTIME_CONFIG_SECTIONS_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/config_reader.h"

namespace rips {

// Files in PEM, absolute paths.
struct TlsFiles {
  std::string ca;    // the root certificate(s) to trust
  std::string cert;  // own certificate, then any intermediate ones
  std::string key;   // private key of `cert`
  // Revocation lists: a file, or a directory of *.pem and *.crl; empty = nothing is revoked.
  std::string crl;
  friend bool operator==(const TlsFiles&, const TlsFiles&) = default;
};

struct DdsSettings {
  uint32_t domain = 0;    // 0..230 (DDSI-RTPS 2.5 §9.6.2.3: ports must stay below 65,536)
  std::string interface;  // network interface; empty = Cyclone's choice
  std::string keystore;   // directory of the security enclaves; empty = no DDS security
  std::string enclave;    // `/rips/sensor`; set exactly when `keystore` is
  bool announce = true;   // ROS tools see this process as node `/rips`
  // Of a gid in what it announces, 16 or 24; 0 = as most ROS processes on the bus.
  uint32_t gid_bytes = 0;
  friend bool operator==(const DdsSettings&, const DdsSettings&) = default;
};

// `tls: {ca, cert, key, crl}`; all absolute and required, but for `crl`.
TlsFiles ReadTls(const ConfigSection& root);
// `dds: {domain, interface, announce, gid_bytes, security: null | {keystore, enclave}}`; optional.
DdsSettings ReadDds(const ConfigSection& root);
// A required key whose value must be a name as in IsValidName; `what` is `robot id`.
void ReadName(const ConfigSection& section, absl::string_view key, absl::string_view what,
              std::string* value);
// An optional whole number from 1 to `max`.
void ReadCount(const ConfigSection& section, absl::string_view key, size_t max, size_t* value);
// An absolute path.
void ReadPath(const ConfigSection& section, absl::string_view key, std::string* value);
// `HOST:PORT`, the port 0 to 65535 and the host not empty; IPv6 as `[::1]:7443`.
bool IsHostPort(absl::string_view text);

// The bytes of a configuration file. NotFound, PermissionDenied, or ResourceExhausted if it is
// longer than kConfigBytesMax.
absl::StatusOr<std::string> ReadConfigFile(const std::string& path);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_CONFIG_SECTIONS_H_
