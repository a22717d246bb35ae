#include "policy_server/policy/engine/state/message_counts.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/state/compiled.h"

namespace rips::engine {
namespace {

// More than this of one loss count as this many.
constexpr uint64_t kLossCountedMax = uint64_t{1} << 32;

// Names the messages of one writer on one topic; no topic holds a zero byte.
std::string SenderKey(absl::string_view topic, const ros2::Guid& writer) {
  return absl::StrCat(topic, absl::string_view("\0", 1), writer.ToBytes());
}

}  // namespace

void CountMessage(const MessageEvent& message, const TopicVerdict& verdict, int64_t time_ns,
                  RobotState::Internal& in) {
  if (verdict.topic_window_ns > 0) {
    in.counts.Add(message.topic, time_ns, verdict.topic_window_ns);
  }
  if (verdict.sender_window_ns > 0 && !message.writer.none()) {
    in.counts.Add(SenderKey(message.topic, message.writer), time_ns, verdict.sender_window_ns);
  }
}

void CountLoss(const model::Loss& loss, int64_t time_ns, RobotState& state) {
  RobotState::Internal& in = state.internal();
  const CompiledPolicy::Compiled& compiled = state.program()->compiled();
  int64_t topic_window_ns = compiled.topic_window_ns;
  int64_t sender_window_ns = compiled.sender_window_ns;
  if (topic_window_ns == 0 && sender_window_ns == 0) return;
  const uint64_t count = std::min(loss.count, kLossCountedMax);
  const int64_t last_ns = loss.last_ns == 0 ? time_ns : std::min(loss.last_ns, time_ns);
  const int64_t first_ns = loss.first_ns == 0 ? last_ns : std::min(loss.first_ns, last_ns);
  if (loss.topic.empty()) {
    in.lost_anywhere.AddLost("", count, first_ns, last_ns,
                             std::max(topic_window_ns, sender_window_ns));
    return;
  }
  if (!loss.type.empty()) {
    const MessageEvent of{.topic = loss.topic, .type = loss.type};
    const TopicVerdict& verdict =
        *in.topics.Look(*state.program(), state.graph.get(), state.graph.revision(), of).verdict;
    topic_window_ns = verdict.topic_window_ns;
    sender_window_ns = verdict.sender_window_ns;
  }
  if (topic_window_ns > 0) {
    in.counts.AddLost(loss.topic, count, first_ns, last_ns, topic_window_ns);
  }
  if (sender_window_ns == 0) return;
  if (loss.writer.none()) {
    in.lost_by_anybody.AddLost(loss.topic, count, first_ns, last_ns, sender_window_ns);
  } else {
    in.counts.AddLost(SenderKey(loss.topic, loss.writer), count, first_ns, last_ns,
                      sender_window_ns);
  }
}

uint64_t CountOfTopic(const MessageEvent& message, int64_t now_ns, int64_t window_ns,
                      const RobotState::Internal& in) {
  return in.counts.Count(message.topic, now_ns, window_ns) +
         in.lost_anywhere.Count("", now_ns, window_ns);
}

uint64_t CountOfSender(const MessageEvent& message, int64_t now_ns, int64_t window_ns,
                       const RobotState::Internal& in) {
  return in.counts.Count(SenderKey(message.topic, message.writer), now_ns, window_ns) +
         in.lost_by_anybody.Count(message.topic, now_ns, window_ns) +
         in.lost_anywhere.Count("", now_ns, window_ns);
}

}  // namespace rips::engine
