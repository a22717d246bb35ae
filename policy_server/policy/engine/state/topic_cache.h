// What has been found out about topics and the graph, so that an event costs only the rules that
// apply to it.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TOPIC_CACHE_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TOPIC_CACHE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/builtins/builtins.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/state/topic_verdicts.h"

namespace rips::engine {

// Answers of predicates, found out when first asked.
class Answers {
 public:
  void Reset() { known_.clear(); }
  // Bytes held.
  size_t size() const { return known_.size(); }

  template <typename Decide>
  bool Get(size_t index, size_t count, const Decide& decide) {
    if (known_.empty()) known_.resize(count);
    uint8_t& answer = known_[index];
    if (answer == 0) answer = decide() ? kYes : kNo;
    return answer == kYes;
  }

 private:
  static constexpr uint8_t kNo = 1;
  static constexpr uint8_t kYes = 2;
  std::vector<uint8_t> known_;
};

// One topic under one program and one graph.
struct TopicEntry {
  // Of the last message.
  std::string type;
  // Views of `type` and of the graph.
  std::vector<absl::string_view> types;
  const ros2::Topic* facts = nullptr;
  const TopicVerdict* verdict = nullptr;
  // By index of Compiled::facts.
  Answers answers;

 private:
  friend class TopicCache;
  // False: to be looked at anew each time.
  bool remembered = false;
  uint64_t revision = 0;
  uint64_t generation = 0;
};

// Not thread-safe.
class TopicCache {
 public:
  static constexpr size_t kTopicsMax = 4'096;
  // Sum of the answers of all topics.
  static constexpr size_t kAnswersMax = 1 << 20;

  // The message's topic; `program` must be the same at each call since Clear(). `revision` changes
  // whenever `graph` does. Valid until the next call and while the graph is.
  TopicEntry& Look(const CompiledPolicy& program, const ros2::RosGraph& graph, uint64_t revision,
                   const MessageEvent& message);
  // Of Compiled::graph, in the graph of that revision.
  Answers& GraphAnswers(uint64_t revision);
  void Clear();

  size_t topics() const { return topics_.size(); }

 private:
  // Null: it is not to be remembered.
  TopicEntry* Find(const CompiledPolicy& program, const MessageEvent& message);
  void Refresh(const CompiledPolicy& program, const ros2::RosGraph& graph,
               const MessageEvent& message, TopicEntry& entry);

  TopicVerdicts verdicts_;
  // Counts the times that all entries were forgotten.
  uint64_t epoch_ = 0;
  absl::flat_hash_map<std::string, std::unique_ptr<TopicEntry>> topics_;
  // Of a topic that is not remembered.
  TopicEntry passing_;
  Answers graph_answers_;
  uint64_t graph_revision_ = 0;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TOPIC_CACHE_H_
