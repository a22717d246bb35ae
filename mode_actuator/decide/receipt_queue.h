// Receipts the server may not have: kept until sent on a live stream, and once more after every
// reconnect as long as they are recent, because the wire has no acknowledgement for them. The
// server drops duplicates. Pure; one thread.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_QUEUE_H_
#define RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_QUEUE_H_

#include <algorithm>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <utility>

#include "mode_actuator/decide/receipt.h"
#include "services/base/clock.h"

namespace rips::actuator {

// The oldest is dropped beyond this; level receipts are repeated by the executor on request.
inline constexpr size_t kReceiptsKeptMax = 128;
inline constexpr int64_t kReceiptKeepNs = 30 * kNanosPerSecond;

class ReceiptQueue {
 public:
  void Add(Receipt receipt) {
    // Of one command only the newest stage is of use; of one decision only the newest receipt, so
    // that a failure that has been mended is not reported again after a reconnect.
    std::erase_if(entries_, [&](const Entry& old) {
      const bool same_decision = !receipt.decision_id.none() &&
                                 old.receipt.decision_id == receipt.decision_id && old.sent_ns != 0;
      return same_decision || old.receipt.command_id == receipt.command_id;
    });
    if (!receipt.decision_id.none() && receipt.decision_id >= newest_decision_id_)
      newest_decision_id_ = receipt.decision_id;
    entries_.push_back({std::move(receipt), 0, 0});
    if (entries_.size() > kReceiptsKeptMax) {
      entries_.pop_front();
      ++dropped_;
    }
  }

  // A stream began: what is still kept is to be sent on it.
  void NewSession() { ++session_; }

  // Calls `send` for what this session has not had, oldest first, until it gives false; forgets
  // what was sent kReceiptKeepNs ago. The newest decision id's receipt is kept as long as it is
  // that.
  void Flush(int64_t now_ns, const std::function<bool(const Receipt&)>& send) {
    for (Entry& entry : entries_) {
      if (entry.session == session_) continue;
      if (!send(entry.receipt)) break;
      entry.session = session_;
      if (entry.sent_ns == 0) entry.sent_ns = now_ns;
    }
    std::erase_if(entries_, [&](const Entry& entry) {
      const bool newest =
          !entry.receipt.decision_id.none() && entry.receipt.decision_id == newest_decision_id_;
      return !newest && entry.sent_ns != 0 && now_ns - entry.sent_ns > kReceiptKeepNs;
    });
  }

  size_t size() const { return entries_.size(); }
  uint64_t dropped() const { return dropped_; }

 private:
  struct Entry {
    Receipt receipt;
    uint64_t session = 0;  // that had it last; 0 = none
    int64_t sent_ns = 0;   // first sent; 0 = never
  };

  std::deque<Entry> entries_;
  uint64_t session_ = 0;
  DecisionId newest_decision_id_;
  uint64_t dropped_ = 0;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_RECEIPT_QUEUE_H_
