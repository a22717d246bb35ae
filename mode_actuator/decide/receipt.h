// The result of one command for the server; rips.v1.Receipt without protobuf.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_H_
#define RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_H_

#include <cstdint>
#include <string>
#include <vector>

#include "services/base/decision_id.h"

namespace rips::actuator {

// Of a program step's output, the last bytes; a receipt has up to 64 steps.
inline constexpr size_t kStepOutputBytesMax = 4 << 10;

// How far a drill went with a step. Values as in rips.v1.StepResult.Drilled.
enum class Drilled : uint8_t {
  kNoDrill = 0,  // carried out
  kDone = 1,     // carried out as a drill, or carried out and taken back
  kLooked = 2,   // looked only whether what it needs is there and answers
  kNot = 3,      // not tried
};

struct StepResult {
  std::string step;  // `system_mode /safety=ALERT`, `program usb_alarm`
  bool ok = false;
  uint32_t took_ms = 0;
  std::string detail;
  Drilled drilled = Drilled::kNoDrill;
  std::string output_tail;  // of a program, at most kStepOutputBytesMax
};

struct Receipt {
  // Values as in rips.v1.Receipt.Stage.
  enum class Stage : uint8_t {
    kAcknowledged = 1,
    kVerified = 2,
    kFailed = 3,
    kSuperseded = 4,
    kRefusedStale = 5,
    kRefused = 6,
    kUnknown = 7,
  };

  std::string command_id;
  DecisionId decision_id;  // none for programs
  Stage stage = Stage::kAcknowledged;
  std::vector<StepResult> steps;
  int32_t exit_code = 0;    // programs; 128 + signal if killed
  std::string output_tail;  // programs
  std::string detail;
  std::string effective_level;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_H_
