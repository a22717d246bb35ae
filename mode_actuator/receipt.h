// What the actuator tells the server of one command; rips.v1.Receipt without protobuf.
#ifndef RIPS_MODE_ACTUATOR_RECEIPT_H_
#define RIPS_MODE_ACTUATOR_RECEIPT_H_

#include <cstdint>
#include <string>
#include <vector>

#include "services/base/mark.h"

namespace rips::actuator {

struct StepResult {
  std::string step;  // `system_mode /safety=ALERT`, `program usb_alarm`
  bool ok = false;
  uint32_t took_ms = 0;
  std::string detail;
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
  Mark mark;  // none for programs
  Stage stage = Stage::kAcknowledged;
  std::vector<StepResult> steps;
  int32_t exit_code = 0;    // programs; 128 + signal if killed
  std::string output_tail;  // programs
  std::string detail;
  std::string effective_level;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_RECEIPT_H_
