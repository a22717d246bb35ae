// Fetches an agent's certificates from the policy server: the first with a token, the next with the
// one that it has.
#ifndef RIPS_SERVICES_ENROL_FETCH_H_
#define RIPS_SERVICES_ENROL_FETCH_H_

#include <string>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "rips/v1/enrolment.pb.h"
#include "services/enrol/key_folder.h"
#include "services/rpc/certificate.h"

namespace rips::enrol {

// A certificate is due when so much of its life is over; the server's first notice comes at two
// thirds.
inline constexpr double kDueAfter = 0.6;

// Fetches the certificate of `role` (one of the token's) into the folder, and returns what it says.
// Nothing changes on errors, except that the key stays pending: the same key can be asked for again
// when the answer was lost. Errors name what is wrong and what to do.
// FailedPrecondition if the folder holds a certificate of something else, unless
// `replace_identity`; DataLoss if the server sent another certificate than it was asked for.
absl::StatusOr<rpc::Peer> FetchFirst(const v1::EnrolmentToken& token, const std::string& role,
                                     const KeyFolder& folder, absl::Duration timeout,
                                     bool replace_identity = false);

// Fetches a new certificate, with a new key, for what the present one says. `server` is HOST:PORT.
absl::StatusOr<rpc::Peer> Renew(const KeyFolder& folder, const std::string& server,
                                absl::Duration timeout);

// What is in the folder. Errors of rpc::ReadOwnCertificate.
absl::StatusOr<rpc::Peer> Present(const KeyFolder& folder);
bool IsDue(const rpc::Peer& certificate, absl::Time now);

}  // namespace rips::enrol

#endif  // RIPS_SERVICES_ENROL_FETCH_H_
