// The event that tells a receiver of alerts that it will never get. It looks like an alert of the
// server: robot `(server)`, rule `(rips)`, severity high, event `gap`; its id is made of the output
// and the sequences. It is in no store.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_GAP_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_GAP_H_

#include <cstdint>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/server/store/found_records.h"
#include "policy_server/server/store/records.h"

namespace rips::outputs {

struct Gap {
  // Sequences of the store between which alerts are missing.
  uint64_t after = 0;
  uint64_t up_to = 0;
  // How many, whether the output would have sent them or not; 0 = not known.
  uint64_t count = 0;
};

store::AlertRecord MakeGapEvent(absl::string_view output, const Gap& gap, int64_t now_unix_ns);

// Sequences of the page, which is not empty and was read after `sequence`, that the store has
// forgotten. Alerts are forgotten robot by robot, so that they may lie anywhere in it.
uint64_t CountForgotten(const store::AlertPage& page, uint64_t sequence);

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_GAP_H_
