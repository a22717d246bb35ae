// The folder of one agent's certificate, such as /etc/rips/pki/sensor:
//
//   ca.pem cert.pem key.pem   links into `current`; what the agent's configuration names
//   current                   link to the newest of `versions`; all three change with it, at once
//   versions/UTC.RANDOM/      ca.pem, cert.pem, key.pem, server; the two newest are kept
//   pending.pem               the key that a certificate was asked for and has not come yet
//
// Files belong to who owns the folder, and its group may read them. One process at a time (Lock).
#ifndef RIPS_SERVICES_ENROL_KEY_FOLDER_H_
#define RIPS_SERVICES_ENROL_KEY_FOLDER_H_

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/unique_fd.h"

namespace rips::enrol {

// Names of folders that are removed when the folder is locked begin so.
inline constexpr absl::string_view kTokenFolder = ".token-";

struct KeyFiles {
  std::string ca_pem;
  std::string certificates_pem;
  std::string key_pem;
  // HOST:PORT that renews them.
  std::string server;
};

class KeyFolder {
 public:
  explicit KeyFolder(std::string path) : path_(std::move(path)) {}

  const std::string& path() const { return path_; }
  TlsFiles tls() const;

  // Makes the folder (mode 0750) if there is none, and locks it until what is returned goes.
  // FailedPrecondition if another process has it, it is another user's, or its group or others may
  // write into it.
  absl::StatusOr<UniqueFd> Lock() const;
  // The key that is pending, or a new one, which is on the disk when this returns.
  absl::StatusOr<std::string> PendingKey() const;
  // A power cut at any point leaves the old files or the new ones. Afterwards nothing is pending.
  absl::Status Install(const KeyFiles& files) const;
  // Empty if these files were not installed by us.
  std::string Server() const;
  // The URI of the certificate that is there; empty if there is none that can be read.
  std::string Holder() const;
  // Something is there, whether it can be used or not.
  bool HasCertificate() const;

 private:
  absl::Status WriteVersion(const std::string& version, const KeyFiles& files) const;
  absl::Status Link(const std::string& name, const std::string& target) const;
  void RemoveOldVersions() const;
  void RemoveLeftovers() const;

  const std::string path_;
};

}  // namespace rips::enrol

#endif  // RIPS_SERVICES_ENROL_KEY_FOLDER_H_
