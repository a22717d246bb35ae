#include "policy_server/server/enrol/external_ca.h"

#include <sys/stat.h>
#include <sysexits.h>

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "services/base/cut_text.h"
#include "services/runtime/log.h"
#include "services/runtime/run_to_end.h"
#include "services/text/quote.h"

namespace rips::enrol {
namespace {

// Without a PATH of ours, as systemd sets one.
constexpr absl::string_view kUsualPath = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin";

// As RunToEnd and shells give the end by a signal.
constexpr int kSignalCodes = 128;

std::vector<std::string> EnvironmentOf(const pki::CertificateOrder& order,
                                       const CertificateHolder& holder) {
  const char* const path = std::getenv("PATH");
  const int64_t seconds = absl::ToInt64Seconds(order.life);
  constexpr int64_t kDay = 24 * 60 * 60;
  return {absl::StrCat("PATH=", path == nullptr ? kUsualPath : path),
          absl::StrCat("RIPS_IDENTITY=", rpc::ToString(order.identity)),
          absl::StrCat("RIPS_ROLE=", rpc::RoleName(order.identity.role)),
          absl::StrCat("RIPS_ROBOT=", holder.robot),
          absl::StrCat("RIPS_HOST=", holder.host),
          absl::StrCat("RIPS_DAYS=", (seconds + kDay - 1) / kDay),
          absl::StrCat("RIPS_SECONDS=", seconds)};
}

// The start of an untrusted text, on one line; the log escapes its control characters.
std::string OneLine(absl::string_view text) {
  return Shortened(absl::StrReplaceAll(absl::StripAsciiWhitespace(text), {{"\n", "; "}}),
                   kExternalCaReasonBytesMax);
}

absl::Status Unusable(const std::string& path, absl::string_view why) {
  return absl::FailedPreconditionError(absl::StrCat(
      "`enrolment.external_ca.program` of the policy server: ", QuoteBytes(path), " ", why));
}

}  // namespace

absl::Status CheckExternalCaProgram(const std::string& path) {
  if (path.empty() || path.front() != '/') return Unusable(path, "is not an absolute path");
  struct stat info {};
  if (stat(path.c_str(), &info) != 0) {
    return Unusable(path, absl::StrCat("cannot be found: ", std::strerror(errno)));
  }
  if (!S_ISREG(info.st_mode)) return Unusable(path, "is no regular file");
  if ((info.st_mode & (S_IXUSR | S_IXGRP | S_IXOTH)) == 0) {
    return Unusable(path, "is not executable; chmod a+x");
  }
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
    return Unusable(path, "can be written by its group or by others; chmod go-w");
  }
  return absl::OkStatus();
}

absl::Status ExternalCa::Fail(absl::string_view reason, const absl::Status& status,
                              const pki::CertificateOrder& order, absl::string_view said) const {
  if (options_.failed) options_.failed(reason);
  LogWarning("external certificate authority failed", {{"uri", rpc::ToString(order.identity)},
                                                       {"reason", reason},
                                                       {"why", status.message()},
                                                       {"stderr", OneLine(said)}});
  return status;
}

absl::StatusOr<pki::Issued> ExternalCa::Sign(pki::CertificateOrder order,
                                             const std::string& request_pem,
                                             const CertificateHolder& holder,
                                             absl::string_view ca_pem) const {
  if (const absl::Status bad = CheckExternalCaProgram(options_.program[0]); !bad.ok()) {
    return Fail("unusable", bad, order, "");
  }
  const absl::StatusOr<ProgramEnd> end = RunToEnd({.words = options_.program,
                                                   .environment = EnvironmentOf(order, holder),
                                                   .input = request_pem,
                                                   .timeout = options_.timeout,
                                                   .output_bytes_max = kExternalCaBytesMax,
                                                   .cancel_fd = stopped_.get()});
  const std::string authority = "the certificate authority of the policy server ";
  if (absl::IsCancelled(end.status())) {
    return absl::UnavailableError("the policy server is stopping; try again later");
  }
  if (absl::IsResourceExhausted(end.status())) {
    return Fail("wrong",
                absl::FailedPreconditionError(
                    absl::StrCat(authority, "gave a wrong answer: ", end.status().message())),
                order, "");
  }
  if (!end.ok()) {
    if (!absl::IsDeadlineExceeded(end.status())) {
      return Fail("not_started",
                  absl::FailedPreconditionError(absl::StrCat(
                      authority, "did not start: ", end.status().message(),
                      "; does its first line name an interpreter that is there, without a carriage "
                      "return behind it?")),
                  order, "");
    }
    return Fail("timeout",
                absl::UnavailableError(absl::StrCat(
                    authority, "is not available: ", end.status().message(), "; try again later")),
                order, "");
  }
  if (end->exit_code == EX_TEMPFAIL) {
    return Fail("try_later",
                absl::UnavailableError(
                    absl::StrCat(authority, "asks to try again later; the server's log says why")),
                order, end->err);
  }
  if (end->exit_code > kSignalCodes) {
    return Fail(
        "killed",
        absl::UnavailableError(absl::StrCat(authority, "was ended by signal ",
                                            end->exit_code - kSignalCodes, "; try again later")),
        order, end->err);
  }
  if (end->exit_code != 0) {
    return Fail(
        "refused",
        absl::PermissionDeniedError(absl::StrCat(authority, "refused with exit code ",
                                                 end->exit_code, "; the server's log says why")),
        order, end->err);
  }
  // The run took its time.
  order.now = absl::FromUnixNanos(clock_->Now().unix_ns);
  absl::StatusOr<pki::Issued> issued = pki::CheckIssued(end->out, order, ca_pem);
  if (issued.ok()) return issued;
  return Fail("wrong",
              absl::FailedPreconditionError(
                  absl::StrCat(authority, "gave a wrong certificate: ", issued.status().message())),
              order, end->err);
}

}  // namespace rips::enrol
