#include "policy_server/policy/engine/state/compiled.h"

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "policy_server/policy/engine/state/compiled_policy.h"

namespace rips::engine {

CompiledPolicy::CompiledPolicy(lang::CheckedRules rules, CompiledPolicyOptions options)
    : rules_(std::move(rules)), options_(options) {}
CompiledPolicy::~CompiledPolicy() = default;

void Patterns::Add(absl::string_view pattern, uint32_t predicate) {
  patterns_.emplace_back(pattern);
  predicates_.push_back(predicate);
}

void Patterns::Seal() {
  if (patterns_.size() < kWorthwhile) return;
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(kBytesMax);
  set_ = std::make_unique<RE2::Set>(options, RE2::UNANCHORED);
  for (const std::string& pattern : patterns_) {
    if (set_->Add(pattern, nullptr) < 0) {
      set_.reset();
      return;
    }
  }
  // Needs too much memory: they are searched one by one.
  if (!set_->Compile()) set_.reset();
  patterns_.clear();
}

bool Patterns::Search(absl::string_view topic, std::vector<bool>& holds) const {
  if (set_ == nullptr) return false;
  std::vector<int> found;
  RE2::Set::ErrorInfo error;
  const bool any = set_->Match(re2::StringPiece(topic.data(), topic.size()), &found, &error);
  // "No match" may also mean that it gave up.
  if (!any && error.kind != RE2::Set::kNoError) return false;
  for (const int index : found) holds[predicates_[static_cast<size_t>(index)]] = true;
  return true;
}

}  // namespace rips::engine
