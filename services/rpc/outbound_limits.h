// How much may wait for a peer that does not read. Header only.
#ifndef RIPS_SERVICES_RPC_OUTBOUND_LIMITS_H_
#define RIPS_SERVICES_RPC_OUTBOUND_LIMITS_H_

#include <cstddef>
#include <functional>
#include <memory>
#include <string>

#include "services/rpc/send_budget.h"

namespace rips::rpc {

struct OutboundLimits {
  // That wait to be written, the one being written included.
  size_t messages = 4'096;
  // Their size in memory, one message excepted.
  size_t bytes = size_t{8} << 20;
  // Shared with other streams; null = not. `owner`: whose stream this is.
  std::shared_ptr<SendBudget> budget = nullptr;
  std::string owner = "";
  // Called once when the call is ended for a limit, with the reason; no lock is held. May be empty.
  std::function<void(const std::string&)> exceeded = nullptr;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_OUTBOUND_LIMITS_H_
