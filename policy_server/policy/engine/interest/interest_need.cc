#include "policy_server/policy/engine/interest/interest_need.h"

#include "policy_server/policy/lang/limits.h"
#include "re2/re2.h"

namespace rips::engine {
namespace {

bool MatchesTopic(const RE2* pattern, absl::string_view topic) {
  return pattern == nullptr ||
         RE2::PartialMatch(re2::StringPiece(topic.data(), topic.size()), *pattern);
}

}  // namespace

InterestReader::InterestReader(const Interest& interest) {
  for (const TopicInterest& row : interest.plan) {
    plan_.emplace_back(Compiled(row.topic_regex), Need{row.depth, row.payload_bytes_max});
  }
  for (const PayloadLimit& limit : interest.limits) {
    limits_.emplace_back(Compiled(limit.topic_regex), limit.bytes);
  }
}

InterestReader::~InterestReader() = default;

InterestReader::Pattern InterestReader::Compiled(const std::string& regex) {
  if (regex.empty()) return nullptr;
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(lang::kRegexBytesMax);
  auto pattern = std::make_unique<const RE2>(regex, options);
  if (!pattern->ok()) {
    instructions_ += kInterestInstructionsMax + 1;
    return nullptr;
  }
  instructions_ += static_cast<size_t>(pattern->ProgramSize());
  return pattern;
}

Need InterestReader::Of(absl::string_view topic) {
  const auto it = known_.find(topic);
  if (it != known_.end()) return it->second;
  if (known_.size() >= kTopicsMax) known_.clear();
  return known_.emplace(std::string(topic), Find(topic)).first->second;
}

Need InterestReader::Find(absl::string_view topic) const {
  for (const auto& [pattern, need] : plan_) {
    if (!MatchesTopic(pattern.get(), topic)) continue;
    if (need.depth != Depth::kPayload) return {.depth = need.depth};
    for (const auto& [limited, bytes] : limits_) {
      if (MatchesTopic(limited.get(), topic)) return {need.depth, bytes};
    }
    return need;
  }
  return {};
}

}  // namespace rips::engine
