#include "policy_server/policy/inspect/yara_scanner.h"

#include <yara.h>

#include <cstdint>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"

namespace rips::inspect {
namespace {

using engine::Verdict;

// FAST_MODE: one match of a string is enough. NO_TRYCATCH: payloads are in our own memory, so there
// is no file that could vanish below the scan, and no signal handler of the process to replace.
constexpr int kScanFlags =
    SCAN_FLAGS_FAST_MODE | SCAN_FLAGS_NO_TRYCATCH | SCAN_FLAGS_REPORT_RULES_MATCHING;

int OnScan(YR_SCAN_CONTEXT* /*context*/, int message, void* /*data*/, void* user_data) {
  switch (message) {
    case CALLBACK_MSG_RULE_MATCHING:
      *static_cast<bool*>(user_data) = true;
      return CALLBACK_ABORT;
    case CALLBACK_MSG_TOO_MANY_MATCHES:  // libyara would go on without that string
    case CALLBACK_MSG_IMPORT_MODULE:     // YaraRules has none
      return CALLBACK_ERROR;
    default:
      return CALLBACK_CONTINUE;
  }
}

void SetTimeout(YR_SCANNER* scanner, absl::Duration timeout) {
  constexpr uint64_t kNanosPerSecondUnsigned = kNanosPerSecond;
  yr_scanner_set_timeout(scanner, 1);
  if (scanner->timeout == kNanosPerSecondUnsigned) {
    scanner->timeout = absl::ToInt64Nanoseconds(timeout);
  } else {
    yr_scanner_set_timeout(scanner, absl::ToInt64Seconds(timeout + absl::Seconds(1)));
  }
}

std::string Explain(int code) {
  switch (code) {
    case ERROR_SCAN_TIMEOUT:
      return "the scan took too long";
    case ERROR_TOO_MANY_MATCHES:
    case ERROR_CALLBACK_ERROR:
      return "a string matches too often";
    case ERROR_TOO_MANY_RE_FIBERS:
      return "a regular expression branches too often";
    case ERROR_INSUFFICIENT_MEMORY:
      return "no memory";
    default:
      return absl::StrCat("libyara error ", code);
  }
}

}  // namespace

YaraScanner::YaraScanner(const YaraRules& rules) : rules_(rules) {}

void YaraScanner::Destroy::operator()(YR_SCAN_CONTEXT* scanner) const {
  yr_scanner_destroy(scanner);
}

bool YaraScanner::Ready() {
  if (scanner_ != nullptr) return true;
  YR_SCANNER* scanner = nullptr;
  const int code = yr_scanner_create(rules_.raw(), &scanner);
  if (code != ERROR_SUCCESS) {
    failure_ = Explain(code);
    return false;
  }
  scanner_.reset(scanner);
  yr_scanner_set_flags(scanner, kScanFlags);
  return true;
}

Verdict YaraScanner::Scan(absl::string_view bytes, absl::Duration timeout) {
  if (timeout <= absl::ZeroDuration()) {
    failure_ = "no time";
    return Verdict::kUnscanned;
  }
  if (!Ready()) return Verdict::kUnscanned;
  bool matched = false;
  yr_scanner_set_callback(scanner_.get(), OnScan, &matched);
  SetTimeout(scanner_.get(), timeout);

  const uint8_t nothing = 0;
  const auto* data = bytes.empty() ? &nothing : reinterpret_cast<const uint8_t*>(bytes.data());
  const int code = yr_scanner_scan_mem(scanner_.get(), data, bytes.size());

  if (matched) return Verdict::kYes;
  if (code == ERROR_SUCCESS) return Verdict::kNo;
  failure_ = Explain(code);
  scanner_.reset();
  return Verdict::kUnscanned;
}

}  // namespace rips::inspect
