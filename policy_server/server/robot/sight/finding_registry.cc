#include "policy_server/server/robot/sight/finding_registry.h"

#include <algorithm>

namespace rips::pipeline {

FindingRegistry::News FindingRegistry::Apply(const std::string& host,
                                             const std::string& incarnation,
                                             const FindingSeen& seen, int64_t now_ns) {
  const auto it = entries_.find(KeyOf(seen));
  if (seen.over) {
    if (it == entries_.end()) return News::kKnown;
    it->second.told_by.erase(host);
    if (!it->second.told_by.empty()) return News::kKnown;
    entries_.erase(it);
    return News::kEnds;
  }
  // What an earlier incarnation saw need not stand any more.
  const auto current = incarnations_.find(host);
  const bool old = current != incarnations_.end() && current->second != incarnation;
  const int64_t until_ns = old ? now_ns + limits_.confirm_ns : 0;
  if (it != entries_.end()) {
    const auto [told, is_new] = it->second.told_by.try_emplace(host, until_ns);
    if (!old) told->second = 0;
    return News::kKnown;
  }
  if (entries_.size() >= limits_.standing) return News::kTooMany;
  Entry& entry = entries_[KeyOf(seen)];
  entry.finding = seen;
  entry.order = ++last_order_;
  entry.told_by[host] = until_ns;
  return News::kBegins;
}

void FindingRegistry::OnIncarnation(const std::string& host, const std::string& incarnation,
                                    int64_t now_ns) {
  std::string& current = incarnations_[host];
  if (current == incarnation) return;
  current = incarnation;
  for (auto& [key, entry] : entries_) {
    const auto told = entry.told_by.find(host);
    if (told != entry.told_by.end() && told->second == 0) {
      told->second = now_ns + limits_.confirm_ns;
    }
  }
}

std::vector<FindingSeen> FindingRegistry::Expire(int64_t now_ns) {
  std::vector<FindingSeen> gone;
  for (auto it = entries_.begin(); it != entries_.end();) {
    Entry& entry = it->second;
    absl::erase_if(entry.told_by, [now_ns](const auto& told) {
      return told.second != 0 && told.second <= now_ns;
    });
    if (!entry.told_by.empty()) {
      ++it;
      continue;
    }
    gone.push_back(std::move(entry.finding));
    it = entries_.erase(it);
  }
  return gone;
}

std::vector<FindingSeen> FindingRegistry::standing() const {
  std::vector<const Entry*> entries;
  entries.reserve(entries_.size());
  for (const auto& [key, entry] : entries_) entries.push_back(&entry);
  std::sort(entries.begin(), entries.end(),
            [](const Entry* a, const Entry* b) { return a->order < b->order; });
  std::vector<FindingSeen> standing;
  standing.reserve(entries.size());
  for (const Entry* entry : entries) standing.push_back(entry->finding);
  return standing;
}

}  // namespace rips::pipeline
