// Port: bringing a part of the robot into a mode, and seeing whether it is there.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_PART_MODES_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_PART_MODES_H_

#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace rips {
class CancelFlag;
}

namespace rips::actuator {

// Who brings the parts of a robot into their modes, and how that is read back.
enum class Verify { kParts, kManager };

enum class Backend {
  kManager,  // the mode manager of System Modes
  kDirect,   // the nodes' own lifecycle and parameter services; the manager is not asked
};

// What follows when the mode manager fails. kDirect needs Verify::kParts.
enum class Fallback { kDirect, kNone };

struct ModesOptions {
  Verify verify = Verify::kParts;
  Backend backend = Backend::kManager;
  Fallback fallback = Fallback::kDirect;  // of Backend::kManager
};

struct ModeReading {
  // OK: read back and found to be so. Else what was found instead, part by part.
  absl::Status status;
  // The mode the robot says it is in; `?` if it does not say.
  std::string observed = "?";
  // A warning although it succeeded; empty mostly.
  std::string note = {};
};

// What was read of a part, whatever its mode is.
struct PartReading {
  // Modes of levels with which every node that answered agrees; empty if no node answered.
  std::vector<std::string> agreeing;
  std::string named;      // the mode that the mode manager names; empty if it names none
  size_t answers = 0;     // of nodes and manager: a reading with more of them is a better one
  bool complete = false;  // to ask again would give no better reading
};

// One thread at a time.
class PartModes {
 public:
  virtual ~PartModes() = default;

  // Orders `mode` and waits until it is read back: 1 + `retries` attempts of `timeout` each.
  // InvalidArgument if the robot refuses the order (no use to try again), Cancelled, Unavailable
  // if no node accepts the order, DeadlineExceeded if the mode was not reached.
  virtual ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout,
                            int retries, const CancelFlag& cancel) = 0;

  // Looks once. FailedPrecondition if `part` is in another mode.
  virtual ModeReading Check(absl::string_view part, absl::string_view mode,
                            const CancelFlag& cancel) = 0;

  // Looks whether Enter could work now, and orders nothing: OK if all that it needs answers and
  // knows the mode. Unavailable or FailedPrecondition saying who does not, Cancelled;
  // Unimplemented if that is not known.
  virtual ModeReading Probe(absl::string_view, absl::string_view, const CancelFlag&) {
    return {.status = absl::UnimplementedError("not tried: a mode can only be ordered")};
  }

  // Reads which modes of levels `part` may be in, and orders nothing. Returns after about
  // `at_most`, or soon after `cancel`, with what was read until then.
  virtual PartReading Read(absl::string_view, absl::Duration, const CancelFlag&) {
    return {.complete = true};
  }
};

// Stands in for the robot's System Modes while they cannot be reached: every step fails and says
// why, so that the other steps of a level (alarm, firewall, programs) are carried out all the same.
class MissingModes final : public PartModes {
 public:
  // Before use.
  void set_why(const absl::Status& why) { why_ = absl::UnavailableError(why.message()); }

  ModeReading Enter(absl::string_view, absl::string_view, absl::Duration, int,
                    const CancelFlag&) override {
    return {.status = why_};
  }
  ModeReading Check(absl::string_view, absl::string_view, const CancelFlag&) override {
    return {.status = why_};
  }
  ModeReading Probe(absl::string_view, absl::string_view, const CancelFlag&) override {
    return {.status = why_};
  }

 private:
  absl::Status why_ = absl::UnavailableError("there is no way to the System Modes");
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_PART_MODES_H_
