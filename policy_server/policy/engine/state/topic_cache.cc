#include "policy_server/policy/engine/state/topic_cache.h"

#include <algorithm>

#include "policy_server/policy/engine/state/compiled.h"

namespace rips::engine {

TopicEntry& TopicCache::Look(const CompiledPolicy& program, const ros2::RosGraph& graph,
                             uint64_t revision, const MessageEvent& message) {
  TopicMemo* const memo = message.memo;
  const bool known = memo != nullptr && memo->cache == this && memo->epoch == epoch_ &&
                     memo->type == message.type.data();
  TopicEntry* entry = known ? static_cast<TopicEntry*>(memo->entry) : Find(program, message);
  if (entry == nullptr) {
    Refresh(program, graph, message, passing_);
    return passing_;
  }
  // A memo is of this type's name, but the entry may have been used for another meanwhile.
  if (!entry->remembered || entry->revision != revision ||
      entry->generation != verdicts_.generation() || entry->type != message.type) {
    Refresh(program, graph, message, *entry);
    entry->revision = revision;
  }
  if (memo != nullptr && !known) {
    *memo = {.cache = this, .epoch = epoch_, .entry = entry, .type = message.type.data()};
  }
  return *entry;
}

TopicEntry* TopicCache::Find(const CompiledPolicy& program, const MessageEvent& message) {
  const auto found = topics_.find(message.topic);
  if (found != topics_.end()) return found->second.get();
  if (message.topic.size() > TopicVerdicts::kNameBytesMax ||
      message.type.size() > TopicVerdicts::kNameBytesMax) {
    return nullptr;
  }
  const size_t each = program.compiled().facts.size();
  if (topics_.size() >= kTopicsMax || (topics_.size() + 1) * each > kAnswersMax) Clear();
  return topics_.emplace(std::string(message.topic), std::make_unique<TopicEntry>())
      .first->second.get();
}

void TopicCache::Refresh(const CompiledPolicy& program, const ros2::RosGraph& graph,
                         const MessageEvent& message, TopicEntry& entry) {
  entry.type = std::string(message.type);
  entry.facts = graph.FindTopic(message.topic);
  entry.types.clear();
  if (entry.facts != nullptr) {
    entry.types.assign(entry.facts->types.begin(), entry.facts->types.end());
  }
  if (!entry.type.empty() &&
      std::find(entry.types.begin(), entry.types.end(), entry.type) == entry.types.end()) {
    entry.types.push_back(entry.type);
  }
  entry.answers.Reset();
  const EvalContext scene = {.graph = graph,
                             .dialect = program.rules().dialect,
                             .topic = message.topic,
                             .types = entry.types,
                             .facts = entry.facts};
  entry.remembered = TopicVerdicts::Remembers(scene);
  entry.verdict = &verdicts_.For(program, scene);
  entry.generation = verdicts_.generation();
}

Answers& TopicCache::GraphAnswers(uint64_t revision) {
  if (graph_revision_ != revision) {
    graph_answers_.Reset();
    graph_revision_ = revision;
  }
  return graph_answers_;
}

void TopicCache::Clear() {
  topics_.clear();
  ++epoch_;
  verdicts_.Clear();
  graph_answers_.Reset();
}

}  // namespace rips::engine
