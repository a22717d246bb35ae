// An enclave of a DDS Security keystore, laid out as SROS2 does:
//
//   KEYSTORE/enclaves/ENCLAVE/identity_ca.cert.pem     who vouches for names
//                             cert.pem, key.pem        our name, as subject `CN=ENCLAVE`
//                             permissions_ca.cert.pem  who says what a name may do
//                             governance.p7s           what the domain asks of everybody
//                             permissions.p7s          what our name may do
//                             crl.pem                  names taken back; optional
#ifndef RIPS_SERVICES_DDS_SECURITY_H_
#define RIPS_SERVICES_DDS_SECURITY_H_

#include <cstddef>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/ros2/guid.h"
#include "services/runtime/config_sections.h"

namespace rips::dds {

// Bytes of one file of a keystore.
inline constexpr size_t kSecurityFileBytesMax = size_t{1} << 20;

// Absolute paths of files that were found good.
struct Enclave {
  std::string name;
  std::string identity_ca;
  std::string certificate;
  std::string private_key;
  std::string permissions_ca;
  std::string governance;
  std::string permissions;
  std::string crl;  // empty = none
  // A DDS topic that the permissions allow.
  std::string permitted_topic;
  // The governance lets participants in that have not authenticated: which have is not known.
  bool admits_unauthenticated = false;

  friend bool operator==(const Enclave&, const Enclave&) = default;
};

// Reads and checks the files of `enclave` (`/rips/sensor`), which the middleware would refuse later
// and with less to say. Every message names the file.
//
// | code               | when                                                                    |
// |--------------------|-------------------------------------------------------------------------|
// | InvalidArgument    | `keystore` is no absolute path, `enclave` no path of plain names; a file |
// |                    | is not what it should be; the key is not the certificate's; a signature  |
// |                    | or the certificate is of another authority; the permissions name another |
// | NotFound           | a file is missing                                                       |
// | PermissionDenied   | a file cannot be read                                                   |
// | ResourceExhausted  | a file is longer than kSecurityFileBytesMax                             |
// | FailedPrecondition | at `now` the certificate or the permissions do not hold yet or any more |
absl::StatusOr<Enclave> LoadEnclave(absl::string_view keystore, absl::string_view enclave,
                                    absl::Time now);

// True if `participant` is the GUID of one whose certificate has the subject `CN=ENCLAVE` (as UTF-8
// string): its first 47 bits are of that name's hash, and a peer that checks it compares them
// with the certificate (DDS Security 1.1 §9.3.3). What it says of its enclave is proof only then.
bool ProvesEnclave(const ros2::Guid& participant, absl::string_view enclave);

// As above, of `dds: {security: ...}`; none if there is no such setting.
absl::StatusOr<std::optional<Enclave>> LoadSecurity(const DdsSettings& settings, absl::Time now);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_SECURITY_H_
