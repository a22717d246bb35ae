// Charges: the memory that waiting events keep alive, each batch and graph counted once.
#ifndef RIPS_POLICY_SERVER_SERVER_SHADOW_CHARGES_H_
#define RIPS_POLICY_SERVER_SERVER_SHADOW_CHARGES_H_

#include <array>
#include <atomic>
#include <cstddef>
#include <memory>

#include "policy_server/server/robot/model/inbound.h"
#include "services/ros2/ros_graph.h"

namespace rips::shadow {

// Counts while it lives.
class Charge {
 public:
  Charge(std::atomic<size_t>* total, size_t bytes) : total_(*total), bytes_(bytes) {
    total_ += bytes_;
  }
  ~Charge() { total_ -= bytes_; }
  Charge(const Charge&) = delete;
  Charge& operator=(const Charge&) = delete;

 private:
  std::atomic<size_t>& total_;
  const size_t bytes_;
};
// Shared by all that keep the same thing alive: who holds a charge holds that thing, too.
using ChargePtr = std::shared_ptr<const Charge>;

// Charges end on any thread; all else is of one thread at a time. Outlives its charges. Bytes are
// estimated, from above where many graphs take turns.
class Charges {
 public:
  ChargePtr OfBatch(const pipeline::Batch* batch);
  ChargePtr OfGraph(const ros2::RosGraph* graph);
  // Any thread.
  size_t bytes() const { return bytes_; }
  void Add(size_t bytes) { bytes_ += bytes; }
  void Subtract(size_t bytes) { bytes_ -= bytes; }

 private:
  // What was charged last. While the charge lives, the address is of the same thing.
  struct Charged {
    const void* of = nullptr;
    std::weak_ptr<const Charge> charge;
  };

  std::atomic<size_t> bytes_ = 0;
  Charged batch_;
  // Messages may be judged under earlier graphs in turn with the newest.
  std::array<Charged, 4> graphs_;
  size_t next_graph_ = 0;
};

}  // namespace rips::shadow

#endif  // RIPS_POLICY_SERVER_SERVER_SHADOW_CHARGES_H_
