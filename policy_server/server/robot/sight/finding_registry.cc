#include "policy_server/server/robot/sight/finding_registry.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/model/finding_digest.h"

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
    RemoveTellers(it->second, [&host](const std::string& each, int64_t) { return each == host; });
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
    AddTeller(it->second, host, until_ns);
    return News::kKnown;
  }
  if (entries_.size() >= limits_.standing) return News::kTooMany;
  Entry& entry = entries_[std::move(key)];
  entry.finding = seen;
  entry.digest = model::DigestOf(seen);
  entry.order = ++last_order_;
  entry.since_ns = now_ns;
  AddTeller(entry, host, until_ns);
  return News::kBegins;
}

void FindingRegistry::AddEnded(const Key& key, bool named, int64_t now_ns) {
  if (ended_.size() >= limits_.ended) ended_.pop_front();
  ended_.push_back({.key = key, .at_ns = now_ns, .named = named});
}

void FindingRegistry::AddTeller(Entry& entry, const std::string& host, int64_t until_ns) {
  const auto [told, is_new] = entry.told_by.try_emplace(host, until_ns);
  if (is_new) hosts_[host].digest += entry.digest;
  if (until_ns == 0) told->second = 0;
}

void FindingRegistry::RemoveTellers(
    Entry& entry, absl::FunctionRef<bool(const std::string& host, int64_t until_ns)> goes) {
  absl::erase_if(entry.told_by, [&](const auto& told) {
    if (!goes(told.first, told.second)) return false;
    const auto teller = hosts_.find(told.first);
    if (teller != hosts_.end()) teller->second.digest -= entry.digest;
    return true;
  });
}

void FindingRegistry::OnHello(const std::string& host, const std::string& incarnation,
                              int64_t now_ns) {
  Host& current = hosts_[host];
  current.said.reset();
  if (std::exchange(current.incarnation, incarnation) == incarnation) return;
  current.differs_ns = 0;
  MayEnd(host, now_ns);
}

void FindingRegistry::MayEnd(const std::string& host, int64_t now_ns) {
  for (auto& [key, entry] : entries_) {
    const auto told = entry.told_by.find(host);
    if (told != entry.told_by.end() && told->second == 0) {
      told->second = now_ns + limits_.confirm_ns;
    }
  }
}

void FindingRegistry::OnState(const std::string& host, std::optional<uint64_t> digest,
                              bool all_told) {
  hosts_[host].said = {.digest = digest, .all_told = all_told};
}

void FindingRegistry::KeepOnly(absl::FunctionRef<bool(const std::string& host)> listed,
                               int64_t now_ns) {
  for (auto& [key, entry] : entries_) {
    for (auto& [host, until_ns] : entry.told_by) {
      if (!listed(host)) until_ns = now_ns;
    }
  }
  absl::erase_if(hosts_, [&](const auto& host) { return !listed(host.first); });
}

FindingRegistry::Asked FindingRegistry::Ask(const std::string& host, int64_t now_ns) {
  const auto it = hosts_.find(host);
  if (it == hosts_.end()) return Asked::kNo;
  Host& current = it->second;
  if (!current.said) return Asked::kNo;
  if (!current.differs()) {
    current.differs_ns = 0;
    current.in_vain = false;
    return Asked::kNo;
  }
  // More than are kept would be told in vain, and it is not the sensor's fault.
  if (current.differs_ns == 0 || entries_.size() >= limits_.standing) current.differs_ns = now_ns;
  if (now_ns < current.differs_ns + kDiffersNs) return Asked::kNo;
  if (current.asked_ns != 0 && now_ns < current.asked_ns + limits_.confirm_ns) return Asked::kNo;
  const bool in_vain = current.asked_ns >= current.differs_ns;
  current.asked_ns = now_ns;
  MayEnd(host, now_ns);
  return in_vain && !std::exchange(current.in_vain, true) ? Asked::kYesInVain : Asked::kYes;
}

std::vector<FindingRegistry::Entry> FindingRegistry::Expire(int64_t now_ns) {
  std::vector<Entry> gone;
  for (auto it = entries_.begin(); it != entries_.end();) {
    Entry& entry = it->second;
    RemoveTellers(entry, [now_ns](const std::string&, int64_t until_ns) {
      return until_ns != 0 && until_ns <= now_ns;
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

bool FindingRegistry::HasKind(absl::string_view kind) const {
  const auto it = entries_.lower_bound(Key{std::string(kind), ros2::Guid(), "", ""});
  return it != entries_.end() && it->second.finding.kind == kind;
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

std::string FindingRegistry::NotToldAll(const std::string& host) const {
  const auto it = hosts_.find(host);
  if (it == hosts_.end() || !it->second.said) return "has not said yet which findings stand";
  const Said& said = *it->second.said;
  if (!said.digest) return "is of a version that does not say which findings stand";
  if (*said.digest != it->second.digest) {
    if (entries_.size() >= limits_.standing) {
      return absl::StrCat("has reported more findings than the ", limits_.standing,
                          " that are kept");
    }
    const bool asked = it->second.differs_ns != 0 && it->second.asked_ns >= it->second.differs_ns;
    return asked
               ? "finds something else than it has reported; it was restarted, or asked less than "
                 "a minute ago to report all again"
               : "has not confirmed yet what it has reported last";
  }
  if (!said.all_told) {
    return "may find more: it was started less than a minute ago, looks at something for longer, "
           "or finds more within a minute than it may report";
  }
  return "";
}

}  // namespace rips::pipeline
