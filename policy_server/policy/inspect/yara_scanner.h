// Scans payloads with the rules of one YARA file.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_SCANNER_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_SCANNER_H_

#include <memory>
#include <string>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/policy/inspect/yara_rules.h"

struct YR_SCAN_CONTEXT;

namespace rips::inspect {

// One thread at a time; at most 32 of them per YaraRules (YR_MAX_THREADS of libyara). Costs 4 to
// 500 KB, so a worker thread keeps one per file.
class YaraScanner {
 public:
  // `rules` is not owned and outlives this.
  explicit YaraScanner(const YaraRules& rules);

  // Whether a rule that is not private matches `bytes`, of which `filesize` in a condition is the
  // length. The first match is enough. kUnscanned when `timeout` passes, for a `timeout` that is
  // not positive, and for every error of libyara (too many matches or regular-expression states, no
  // memory). Never throws.
  //
  // The timeout is wall time, and no hard bound: libyara looks at its clock once in 4,096 bytes of
  // payload and now and then in a condition, and nothing can stop it in between. With patterns that
  // CheckSpeed refuses, seconds were seen; InspectionPool grows by a thread when that happens. Its
  // API sets whole seconds: if the library at hand keeps the limit in nanoseconds, as 4.2 does, it
  // is set exactly, otherwise rounded up.
  engine::Verdict Scan(absl::string_view bytes, absl::Duration timeout);

  // Why the last scan was kUnscanned; says nothing of the payload.
  absl::string_view failure() const { return failure_; }

 private:
  struct Destroy {
    void operator()(YR_SCAN_CONTEXT* scanner) const;
  };
  bool Ready();

  const YaraRules& rules_;  // Not owned; outlives this.
  // Made at the first scan, and anew after an error: nothing of a failed scan is kept.
  std::unique_ptr<YR_SCAN_CONTEXT, Destroy> scanner_;
  std::string failure_;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_SCANNER_H_
