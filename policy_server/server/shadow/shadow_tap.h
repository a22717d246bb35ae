// ShadowTap: the way from a robot's thread to the shadows' thread.
//
//   the queue holds kEventsMax events, or   the event is dropped and counted as missed
//   kBytesMax and is not empty
//   the level changes                       taken up to kLevelsMore past that, since the shadow's
//                                           level would stay wrong
//   the robot retires                       nothing more comes
//
// The robot's thread copies an event and takes one short lock; it never waits for the shadow, which
// takes all that waits at once: its thread has a low priority, and must seldom hold the lock. What
// the rules in force did is counted here, so that no queue can make it less.
#ifndef RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_TAP_H_
#define RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_TAP_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "absl/base/thread_annotations.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/shadow/charges.h"
#include "services/runtime/mutex.h"

namespace rips::shadow {

// Methods of ShadowRecorder on the robot's thread, the others on any.
class ShadowTap final : public pipeline::ShadowRecorder {
 public:
  static constexpr size_t kEventsMax = 4'096;
  static constexpr size_t kLevelsMore = 64;
  // Of events with the batches and graphs that they keep alive, estimated.
  static constexpr size_t kBytesMax = size_t{8} << 20;

  using Item = std::variant<pipeline::RulesState, pipeline::JudgedEvent, pipeline::LevelChange>;

  struct Live {
    pipeline::RuleCounts counts;
    // Name; empty until OnBegin.
    std::string level;
    uint64_t missed = 0;
  };

  // `on_item` is called when the queue is no longer empty; on the robot's thread, must not block.
  explicit ShadowTap(std::function<void()> on_item) : on_item_(std::move(on_item)) {}

  void OnBegin(pipeline::RulesState state) override ABSL_LOCKS_EXCLUDED(mu_);
  bool OnEvent(const pipeline::JudgedEvent& event) override ABSL_LOCKS_EXCLUDED(mu_);
  bool OnLevel(const pipeline::LevelChange& level) override ABSL_LOCKS_EXCLUDED(mu_);
  bool OnOutcome(const pipeline::RuleOutcome& outcome) override ABSL_LOCKS_EXCLUDED(mu_);
  void OnRetired() override ABSL_LOCKS_EXCLUDED(mu_);

  // The oldest; nullopt = there is none. On the shadows' thread only.
  std::optional<Item> Pop() ABSL_LOCKS_EXCLUDED(mu_);
  // Takes nothing more in, and what waits is dropped.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);
  bool closed() const { return closed_; }
  // All of a robot that has retired was popped. On the shadows' thread only.
  bool retired_and_empty() const ABSL_LOCKS_EXCLUDED(mu_);
  Live live() const ABSL_LOCKS_EXCLUDED(mu_);
  // That wait, and what they keep alive.
  size_t events() const { return events_; }
  size_t bytes() const { return charges_.bytes(); }

 private:
  struct Waiting {
    Item item;
    size_t bytes = 0;
    ChargePtr batch;
    ChargePtr graph;
  };

  // True if the queue was empty.
  bool Push(Waiting waiting) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  void Drop(std::deque<Waiting>& dropped);

  const std::function<void()> on_item_;
  // Of the robot's thread: of the newest message.
  std::shared_ptr<const pipeline::Batch> batch_;
  // Before what counts in them.
  Charges charges_;
  std::atomic<size_t> events_ = 0;
  // Written under mu_.
  std::atomic<bool> closed_ = false;
  // Of the shadows' thread.
  std::deque<Waiting> taken_;
  mutable Mutex mu_;
  std::deque<Waiting> queue_ ABSL_GUARDED_BY(mu_);
  bool retired_ ABSL_GUARDED_BY(mu_) = false;
  Live live_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::shadow

#endif  // RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_TAP_H_
