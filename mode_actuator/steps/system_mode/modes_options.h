// Who brings the parts of a robot into their modes, and how that is read back.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODES_OPTIONS_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODES_OPTIONS_H_

namespace rips::actuator {

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

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODES_OPTIONS_H_
