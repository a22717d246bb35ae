// The result of one command for the server: services/model.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_H_
#define RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_H_

#include <cstddef>

#include "services/model/receipt.h"

namespace rips::actuator {

using model::Drilled;
using model::Receipt;
using model::StepResult;

// Of a program step's output, the last bytes; a receipt has up to 64 steps.
inline constexpr size_t kStepOutputBytesMax = 4 << 10;

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_H_
