#include "policy_server/policy/inspect/scanner_process.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/inspect/jail_spec.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

#ifndef F_SEAL_FUTURE_WRITE
#define F_SEAL_FUTURE_WRITE 0x0010
#endif

namespace rips::inspect {
namespace {

using engine::Verdict;
using Io = ChildProcess::Io;

constexpr int64_t kScannerLogPauseNs = 60 * kNanosPerSecond;

Verdict ToVerdict(char letter) {
  if (letter == '1') return Verdict::kYes;
  if (letter == '0') return Verdict::kNo;
  return Verdict::kUnscanned;
}

}  // namespace

ScannerProcess::ScannerProcess(std::shared_ptr<const RuleImage> rules, ScannerOptions options,
                               const Clock* clock)
    : rules_(std::move(rules)),
      options_(std::move(options)),
      clock_(clock),
      restart_(options_.restart) {}

ScannerProcess::~ScannerProcess() {
  process_.reset();
  if (payload_ != nullptr) munmap(payload_, std::max<size_t>(options_.payload_bytes_max, 1));
}

absl::Status ScannerProcess::MapPayload() {
  if (payload_ != nullptr) return absl::OkStatus();
  const size_t bytes = std::max<size_t>(options_.payload_bytes_max, 1);
  const auto failed = [] {
    return absl::UnavailableError(absl::StrCat("no memory for payloads: ", std::strerror(errno)));
  };
  payload_fd_ = UniqueFd(memfd_create("rips-payload", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (payload_fd_.get() < 0 || ftruncate(payload_fd_.get(), static_cast<off_t>(bytes)) != 0) {
    return failed();
  }
  void* mapped = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, payload_fd_.get(), 0);
  if (mapped == MAP_FAILED) return failed();
  payload_ = static_cast<char*>(mapped);
  fcntl(payload_fd_.get(), F_ADD_SEALS,
        F_SEAL_GROW | F_SEAL_SHRINK | F_SEAL_FUTURE_WRITE | F_SEAL_SEAL);
  return absl::OkStatus();
}

absl::Status ScannerProcess::Start() {
  if (process_ != nullptr) return absl::OkStatus();
  RIPS_RETURN_IF_ERROR(MapPayload());
  const int64_t before_ns = Now();
  ++starts_;
  absl::StatusOr<std::unique_ptr<ChildProcess>> started = ChildProcess::StartScanner(
      rules_->fd(), payload_fd_.get(), options_.process, options_.contain);
  start_ns_ += Now() - before_ns;
  if (!started.ok()) return started.status();
  process_ = *std::move(started);
  return absl::OkStatus();
}

Verdict ScannerProcess::Scan(uint32_t rules, absl::string_view robot, absl::string_view bytes) {
  if (bytes.size() > options_.payload_bytes_max || !restart_.MayAsk(robot, Now())) {
    return Verdict::kUnscanned;
  }
  if (process_ != nullptr && process_->Exited()) process_.reset();
  if (const absl::Status started = Start(); !started.ok()) {
    restart_.StartFailed(Now());
    CountFailure(started.message());
    return Verdict::kUnscanned;
  }
  std::memcpy(payload_, bytes.data(), bytes.size());
  const absl::StatusOr<char> letter = Exchange(rules, bytes.size());
  if (letter.ok()) return ToVerdict(*letter);
  process_.reset();
  restart_.AnswerFailed(robot, Now());
  CountFailure(letter.status().message());
  return Verdict::kUnscanned;
}

absl::StatusOr<char> ScannerProcess::Exchange(uint32_t rules, size_t bytes) {
  const int64_t deadline_ns = Now() + absl::ToInt64Nanoseconds(options_.scan_time + kKillGrace);
  const ScanQuestion question = {.rules = rules,
                                 .bytes = static_cast<uint32_t>(bytes),
                                 .timeout_ns = absl::ToInt64Nanoseconds(options_.scan_time)};
  absl::string_view rest(reinterpret_cast<const char*>(&question), sizeof(question));
  std::string answer;
  // A question fits into the pipe, which is empty.
  if (process_->Write(rest) != Io::kDone) return absl::AbortedError("the scanner has ended");
  while (true) {
    const Io io = process_->Read(answer, 1);
    if (io == Io::kDone) return answer.front();
    if (io == Io::kClosed) return absl::AbortedError("the scanner crashed on a payload");
    if (!process_->Wait(false, deadline_ns, *clock_)) {
      return absl::DeadlineExceededError("a scan was stuck; its process was killed");
    }
  }
}

void ScannerProcess::CountFailure(absl::string_view why) {
  ++failures_;
  const int64_t now_ns = Now();
  if (logged_ns_ != 0 && now_ns - logged_ns_ < kScannerLogPauseNs) return;
  logged_ns_ = now_ns;
  LogWarning("YARA scan failed", {{"why", why}, {"failures", failures_}});
}

}  // namespace rips::inspect
