#include "policy_server/server/robot/sight/finding_registry.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::pipeline {

FindingRegistry::News FindingRegistry::Apply(const std::string& host,
                                             const std::string& incarnation,
                                             const FindingSeen& seen, int64_t now_ns) {
  Key key = KeyOf(seen);
  const auto it = entries_.find(key);
  if (seen.over) {
    if (it == entries_.end()) {
      // Of one that began before the server's start, or was not kept.
      AddEnded(key, false, now_ns);
      return News::kKnown;
    }
    it->second.told_by.erase(host);
    if (!it->second.told_by.empty()) return News::kKnown;
    AddEnded(key, it->second.named, now_ns);
    entries_.erase(it);
    return News::kEnds;
  }
  // What an earlier incarnation saw need not stand any more.
  const auto current = hosts_.find(host);
  const bool old = current != hosts_.end() && current->second.incarnation != incarnation;
  const int64_t until_ns = old ? now_ns + limits_.confirm_ns : 0;
  if (it != entries_.end()) {
    const auto [told, is_new] = it->second.told_by.try_emplace(host, until_ns);
    if (!old) told->second = 0;
    return News::kKnown;
  }
  if (entries_.size() >= limits_.standing) {
    if (current != hosts_.end()) current->second.overflowed = true;
    return News::kTooMany;
  }
  Entry& entry = entries_[std::move(key)];
  entry.finding = seen;
  entry.order = ++last_order_;
  entry.since_ns = now_ns;
  entry.told_by[host] = until_ns;
  return News::kBegins;
}

void FindingRegistry::AddEnded(const Key& key, bool named, int64_t now_ns) {
  if (ended_.size() >= limits_.ended) ended_.pop_front();
  ended_.push_back({.key = key, .at_ns = now_ns, .named = named});
}

void FindingRegistry::OnIncarnation(const std::string& host, const std::string& incarnation,
                                    int64_t now_ns, bool tells_all) {
  Host& current = hosts_[host];
  const bool is_new = current.incarnation != incarnation;
  if (is_new) {
    current = {.incarnation = incarnation};
    for (auto& [key, entry] : entries_) {
      const auto told = entry.told_by.find(host);
      if (told != entry.told_by.end() && told->second == 0) {
        told->second = now_ns + limits_.confirm_ns;
      }
    }
  }
  if (tells_all && current.told_all_ns == kNever) {
    current.told_all_ns = now_ns + limits_.confirm_ns;
  }
}

std::vector<FindingRegistry::Entry> FindingRegistry::Expire(int64_t now_ns) {
  std::vector<Entry> gone;
  for (auto it = entries_.begin(); it != entries_.end();) {
    Entry& entry = it->second;
    absl::erase_if(entry.told_by, [now_ns](const auto& told) {
      return told.second != 0 && told.second <= now_ns;
    });
    if (!entry.told_by.empty()) {
      ++it;
      continue;
    }
    AddEnded(it->first, entry.named, now_ns);
    gone.push_back(std::move(entry));
    it = entries_.erase(it);
  }
  return gone;
}

FindingRegistry::Entry* FindingRegistry::Find(const Key& key) {
  const auto it = entries_.find(key);
  return it == entries_.end() ? nullptr : &it->second;
}

const FindingRegistry::Entry* FindingRegistry::Find(const Key& key) const {
  const auto it = entries_.find(key);
  return it == entries_.end() ? nullptr : &it->second;
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

std::string FindingRegistry::NotToldAll(const std::string& host, int64_t now_ns) const {
  const auto it = hosts_.find(host);
  if (it == hosts_.end()) return "has not connected since the server's start";
  if (it->second.overflowed) {
    return absl::StrCat("has reported more findings than the ", limits_.standing, " that are kept");
  }
  if (it->second.told_all_ns == kNever) {
    return "has not repeated its findings since the server's start";
  }
  if (now_ns < it->second.told_all_ns) {
    return "has connected a moment ago and may not have reported all yet";
  }
  return "";
}

}  // namespace rips::pipeline
