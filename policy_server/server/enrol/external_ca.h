// Signs by a program of the installation: a client of the company's own certificate authority. Each
// certificate is one run of it.
//
// | of a run              | is                                                                    |
// |-----------------------|-----------------------------------------------------------------------|
// | standard input        | the request, PKCS#10 in PEM, which holds a key and no name            |
// | environment           | RIPS_IDENTITY, RIPS_ROLE, RIPS_ROBOT, RIPS_HOST, RIPS_DAYS,           |
// |                       | RIPS_SECONDS, and our PATH; nothing else                              |
// | standard output       | the certificate, then those up to the root; PEM                       |
// | exit code 0           | signed; 75 (EX_TEMPFAIL): try again later; any other: refused         |
// | standard error        | why it refused: one line of the server's log                          |
//
// What it prints is trusted for nothing: pki::CheckIssued compares it with what was asked for.
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_EXTERNAL_CA_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_EXTERNAL_CA_H_

#include <cstddef>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/base/clock.h"
#include "services/pki/certificate_check.h"
#include "services/runtime/wake_fd.h"

namespace rips::enrol {

// Runs at a time: as many threads sign (SigningThreads).
inline constexpr int kExternalCaRunsMax = 4;
// Of standard output, and of standard error.
inline constexpr size_t kExternalCaBytesMax = 64 << 10;
// Of standard error in the log.
inline constexpr size_t kExternalCaReasonBytesMax = 512;

// Label values of rips_enrolment_ca_failures_total.
//
// | reason      | status             | when                                                   |
// |-------------|--------------------|--------------------------------------------------------|
// | unusable    | FailedPrecondition | its file is not as CheckExternalCaProgram wants it     |
// | not_started | FailedPrecondition | the system cannot start it, or its interpreter         |
// | try_later   | Unavailable        | exit code 75                                           |
// | timeout     | Unavailable        | it did not end in time; it is killed with its group    |
// | killed      | Unavailable        | a signal ended it: exit codes above 128                |
// | refused     | PermissionDenied   | any other exit code                                    |
// | wrong       | FailedPrecondition | what it printed is too long, or not what was asked for |
inline constexpr absl::string_view kExternalCaFailures[] = {
    "unusable", "not_started", "try_later", "timeout", "killed", "refused", "wrong"};

struct ExternalCaOptions {
  // The file, absolute, and its arguments; at least one word.
  std::vector<std::string> program;
  absl::Duration timeout = absl::Seconds(10);
  // Called with one of kExternalCaFailures; must not block. May be empty.
  std::function<void(absl::string_view)> failed = {};
};

// What a certificate is for, besides what it says.
struct CertificateHolder {
  std::string robot;
  std::string host;
};

// OK if the file is absolute, regular, executable, and not writable for its group or others.
// FailedPrecondition otherwise, naming it.
absl::Status CheckExternalCaProgram(const std::string& path);

// Any thread.
class ExternalCa {
 public:
  // `clock` is not owned and outlives this.
  ExternalCa(ExternalCaOptions options, const Clock* clock)
      : options_(std::move(options)), clock_(clock) {}

  // Blocks until the program has ended, for `timeout` at most. Errors: the table; Unavailable after
  // Stop. `request_pem` is what `order.request` was read from; `order.now` is not read: what it
  // signed is judged by the time at its end.
  absl::StatusOr<pki::Issued> Sign(pki::CertificateOrder order, const std::string& request_pem,
                                   const CertificateHolder& holder, absl::string_view ca_pem) const;
  // Ends what runs; nothing runs from now on. Idempotent.
  void Stop() { stopped_.Wake(); }

 private:
  absl::Status Fail(absl::string_view reason, const absl::Status& status,
                    const pki::CertificateOrder& order, absl::string_view said) const;

  const ExternalCaOptions options_;
  const Clock* const clock_;
  const WakeFd stopped_;  // never drained
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_EXTERNAL_CA_H_
