#include "sensor_agent/wire/wire_watch.h"

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "sensor_agent/wire/packet_filter.h"

namespace rips::wire {

namespace {

constexpr char kUnicastWriter[] = "unicast_writer";
constexpr char kSpoofedWriter[] = "spoofed_writer";
constexpr const char* kKinds[] = {kUnicastWriter, kSpoofedWriter, kDirectedData, kTwoContents};
// Jumps that are not taken.
constexpr size_t kJumpsMax = 256;

// Ports of one address that a participant sends from at the same time. Cyclone DDS has one socket
// for each address; Fast DDS one for unicast on all addresses, and one for multicast on each. What
// others have is not known; some processes use several transports.
size_t PortsOf(uint16_t vendor) {
  constexpr uint16_t kCyclone = 0x0110;
  constexpr uint16_t kFast = 0x010f;
  switch (vendor) {
    case kCyclone:
      return 1;
    case kFast:
      return 2;
    default:
      return 8;
  }
}

bool HasUnicast(const std::vector<Locator>& locators) {
  return std::any_of(locators.begin(), locators.end(),
                     [](const Locator& each) { return !each.address.multicast(); });
}

// GUID prefixes of participants with DDS Security begin with a one (DDS Security 1.1 §9.3.3).
bool HasSecurePrefix(const ros2::Guid& guid) { return (guid.bytes[0] & 0x80) != 0; }

bool IsUsers(const ros2::Guid& writer) {
  return ClassOf(writer) == EntityClass::kUser && !NamesNoEntity(writer);
}

bool ToMulticast(const Traffic& traffic) {
  return std::any_of(traffic.destinations.begin(), traffic.destinations.end(),
                     [](const Destination& each) { return each.to.address.multicast(); });
}

std::string Datagrams(uint64_t count) {
  return absl::StrCat(count, count == 1 ? " datagram" : " datagrams");
}

}  // namespace

// ------------------------------------------------------------------------------------ discovery

absl::Span<const char* const> WireWatch::Kinds() { return kKinds; }

void WireWatch::ParticipantSeen(const ros2::Guid& participant,
                                const std::vector<Locator>& advertised) {
  const auto it = known_participants_.find(participant);
  if (it == known_participants_.end() &&
      known_participants_.size() >= options_.known_participants) {
    blind_ = true;
    return;
  }
  KnownParticipant& known = known_participants_[participant];
  if (known.gone_ns != 0) {
    // Started again under its old name: from another port, rightly.
    const auto seen = participants_.find(participant);
    if (seen != participants_.end()) {
      seen->second.sources.clear();
      if (known.left) seen->second.numbers.clear();  // it counts from 1
    }
  }
  for (const Locator& each : known.advertised) {
    if (--advertised_[each] == 0) advertised_.erase(each);
  }
  known.advertised = advertised;
  for (const Locator& each : known.advertised) ++advertised_[each];
  known.gone_ns = 0;
  known.left = false;
}

void WireWatch::ParticipantGone(const ros2::Guid& participant, int64_t now_ns) {
  EndForgeries(participant);
  const auto it = known_participants_.find(participant);
  if (it == known_participants_.end()) return;
  it->second.left = true;
  Bury(participant, it->second.gone_ns, now_ns);
}

void WireWatch::Bury(const ros2::Guid& guid, int64_t& gone_ns, int64_t now_ns) {
  if (gone_ns != 0) return;
  gone_ns = now_ns;
  graves_.emplace_back(now_ns, guid);
}

void WireWatch::WriterSeen(const ros2::Guid& writer, const std::string& topic) {
  const auto it = known_writers_.find(writer);
  if (it == known_writers_.end() && known_writers_.size() >= options_.known_writers) {
    blind_ = true;
    return;
  }
  KnownWriter& known = known_writers_[writer];
  known.topic = topic;
  known.gone_ns = 0;
  if (std::exchange(known.left, false)) known.numbers = {};
  const auto seen = participants_.find(writer.Participant());
  if (seen == participants_.end()) return;
  const auto numbers = seen->second.numbers.find(writer);
  if (numbers == seen->second.numbers.end()) return;
  known.numbers = numbers->second;
  seen->second.numbers.erase(numbers);
}

void WireWatch::WriterGone(const ros2::Guid& writer, int64_t now_ns) {
  EndForgeries(writer);
  const auto it = known_writers_.find(writer);
  if (it == known_writers_.end()) return;
  it->second.left = true;
  it->second.reception = nullptr;
  Bury(writer, it->second.gone_ns, now_ns);
}

void WireWatch::WriterRead(const ros2::Guid& writer, int64_t now_ns) {
  const auto it = known_writers_.find(writer);
  if (it == known_writers_.end() || it->second.reception != nullptr) return;
  it->second.reception =
      std::make_unique<Reception>(std::max(now_ns, settled_ns_) + options_.match_ns);
}

void WireWatch::SetReaders(const std::function<bool(const ros2::Guid&)>& reads, int64_t now_ns) {
  for (auto& [guid, known] : known_writers_) {
    if (reads(guid)) {
      WriterRead(guid, now_ns);
    } else {
      known.reception = nullptr;
    }
  }
}

void WireWatch::Received(const ros2::Guid& writer, uint64_t number) {
  const auto it = known_writers_.find(writer);
  if (it == known_writers_.end() || it->second.reception == nullptr || number == 0) return;
  it->second.reception->Received(number);
}

void WireWatch::ReceivedAndLost() {
  for (auto& [guid, known] : known_writers_) {
    if (known.reception != nullptr) known.reception->Excuse();
  }
}

void WireWatch::EndForgeries(const ros2::Guid& gone) {
  const auto ends = [&gone](const ros2::Guid& about) {
    return about == gone || about.Participant() == gone;
  };
  absl::erase_if(forgeries_, [&](const auto& each) { return ends(each.first.second); });
  absl::erase_if(conflicts_, [&](const auto& each) { return ends(each.first); });
}

void WireWatch::Rediscover(int64_t now_ns) {
  for (auto& [guid, known] : known_participants_) Bury(guid, known.gone_ns, now_ns);
  for (auto& [guid, known] : known_writers_) Bury(guid, known.gone_ns, now_ns);
  if (!blind_) return;
  // What was left out is told again now, if there is room; until then it is not unknown.
  blind_ = false;
  if (settled_ns_ != 0) settled_ns_ = now_ns + options_.grace_ns;
}

bool WireWatch::CanSeeAgain() const {
  const auto has_room = [](size_t now, size_t limit) { return now <= limit / 4 * 3; };
  return blind_ && has_room(known_participants_.size(), options_.known_participants) &&
         has_room(known_writers_.size(), options_.known_writers);
}

// ---------------------------------------------------------------------------------------- facts

bool WireWatch::Knows(const ros2::Guid& participant) const {
  return known_participants_.contains(participant);
}

bool WireWatch::IsThere(const ros2::Guid& guid) const {
  const auto participant = known_participants_.find(guid);
  if (participant != known_participants_.end()) return participant->second.gone_ns == 0;
  const auto writer = known_writers_.find(guid);
  return writer != known_writers_.end() && writer->second.gone_ns == 0;
}

bool WireWatch::IsOurs(const Traffic& traffic) const {
  if (traffic.elsewhere > 0 || Knows(traffic.writer.Participant())) return true;
  const PortRange ports = PortsOfDomain(options_.domain);
  for (const Destination& each : traffic.destinations) {
    if (each.to.port >= ports.first && each.to.port <= ports.last) return true;
    if (advertised_.contains(each.to)) return true;
  }
  return false;
}

bool WireWatch::Local(const Address& address) const {
  return address.loopback() || std::binary_search(local_.begin(), local_.end(), address);
}

bool WireWatch::MaySendFrom(const ros2::Guid& participant, const Participant& seen,
                            const Address& address) const {
  const auto known = known_participants_.find(participant);
  if (known == known_participants_.end()) return true;  // that it is unknown is told elsewhere
  std::vector<Locator> advertised = known->second.advertised;
  if (!HasUnicast(advertised)) advertised = {seen.sources.front().from};
  return std::any_of(advertised.begin(), advertised.end(), [&](const Locator& each) {
    if (each.address.multicast()) return false;
    // A host may send to itself from any of its addresses.
    return each.address == address || (Local(each.address) && Local(address));
  });
}

std::string WireWatch::TopicOf(const ros2::Guid& writer) const {
  const auto it = known_writers_.find(writer);
  return it == known_writers_.end() ? std::string() : it->second.topic;
}

// -------------------------------------------------------------------------------------- the tap

void WireWatch::TapChanged() {
  for (auto& [guid, seen] : participants_) seen.sources.clear();
}

void WireWatch::Take(const TapReport& report, int64_t now_ns) {
  local_ = report.local_addresses;
  std::sort(local_.begin(), local_.end());
  for (const Traffic& traffic : report.traffic) {
    if (!IsOurs(traffic)) {
      ++counters_.foreign;
      continue;
    }
    const ros2::Guid guid = traffic.writer.Participant();
    if (!participants_.contains(guid) && participants_.size() >= options_.participants) {
      ++counters_.dropped;
      continue;
    }
    Participant& seen = participants_[guid];
    seen.last_ns = now_ns;
    if (IsParticipantWriter(traffic.writer) && ToMulticast(traffic)) seen.announced = true;
    TakeSource(traffic, now_ns, seen);
    TakeNumbers(traffic, now_ns, seen);
    TakeConflicts(traffic, now_ns);
    if (!Knows(guid)) TakeSuspect(traffic, now_ns, seen.whole);
    if (known_writers_.contains(traffic.writer) || !IsUsers(traffic.writer)) continue;
    if (!seen.writers.contains(traffic.writer) && seen.writers.size() >= options_.writers_each) {
      ++counters_.dropped;
      continue;
    }
    TakeSuspect(traffic, now_ns, seen.writers[traffic.writer]);
  }
}

void WireWatch::TakeNumbers(const Traffic& traffic, int64_t now_ns, Participant& seen) {
  if (NamesNoEntity(traffic.writer)) return;
  const auto known = known_writers_.find(traffic.writer);
  WriterNumbers* numbers = nullptr;
  if (known != known_writers_.end()) {
    numbers = &known->second.numbers;
    if (known->second.reception != nullptr) known->second.reception->OnWire(traffic, now_ns);
  } else {
    if (!seen.numbers.contains(traffic.writer) && seen.numbers.size() >= options_.numbers_each) {
      ++counters_.dropped;
      return;
    }
    numbers = &seen.numbers[traffic.writer];
  }
  const std::string why = numbers->Take(traffic, now_ns);
  if (why.empty() || !Knows(traffic.writer.Participant())) return;
  if (jumps_.size() >= kJumpsMax) {
    ++counters_.findings_dropped;
    return;
  }
  jumps_.push_back(
      {.writer = traffic.writer,
       .detail = absl::StrCat("on the wire from ", ToString(traffic.source), ": ", why)});
}

void WireWatch::TakeConflicts(const Traffic& traffic, int64_t now_ns) {
  if (traffic.conflicts == 0 || !IsUsers(traffic.writer)) return;
  if (options_.secured && HasSecurePrefix(traffic.writer)) return;
  const auto known = known_writers_.find(traffic.writer);
  if (known == known_writers_.end() && !Knows(traffic.writer.Participant())) return;
  if (!conflicts_.contains(traffic.writer) && conflicts_.size() >= options_.findings) {
    ++counters_.findings_dropped;
    return;
  }
  Conflict& conflict = conflicts_[traffic.writer];
  if (conflict.count == 0) {
    conflict.number = traffic.conflict_number;
    conflict.to = traffic.conflict_to;
  }
  conflict.count += traffic.conflicts;
  conflict.last_ns = now_ns;
  if (known == known_writers_.end() || known->second.reception == nullptr) return;
  if (second_contents_.size() >= options_.findings) return;
  second_contents_.push_back(
      {.writer = traffic.writer, .number = traffic.conflict_number, .size = traffic.conflict_size});
}

std::vector<Jump> WireWatch::TakeJumps() {
  if (settled_ns_ == 0) return {};
  return std::exchange(jumps_, {});
}

bool WireWatch::Misses(const ros2::Guid& writer) const {
  return standing_.contains({kDirectedData, writer}) || standing_.contains({kTwoContents, writer});
}

bool WireWatch::MissesSome() const {
  return std::any_of(standing_.begin(), standing_.end(), [](const auto& each) {
    return each.first.first == kDirectedData || each.first.first == kTwoContents;
  });
}

void WireWatch::TakeSuspect(const Traffic& traffic, int64_t now_ns, Suspect& suspect) const {
  if (suspect.packets == 0) suspect.first_ns = now_ns;
  suspect.last_ns = now_ns;
  suspect.packets += traffic.packets;
  suspect.from = traffic.source;
  if (!traffic.destinations.empty()) suspect.to = traffic.destinations.front().to;
}

void WireWatch::TakeSource(const Traffic& traffic, int64_t now_ns, Participant& seen) {
  const ros2::Guid about = IsUsers(traffic.writer) ? traffic.writer : traffic.writer.Participant();
  auto it = std::find_if(seen.sources.begin(), seen.sources.end(),
                         [&](const Source& each) { return each.from == traffic.source; });
  if (it == seen.sources.end()) {
    if (seen.sources.size() >= options_.sources_each) {
      ++counters_.dropped;
      return;
    }
    seen.sources.push_back({.from = traffic.source,
                            .vendor = traffic.vendor,
                            .first_ns = now_ns,
                            .first_packet = traffic.first_packet,
                            .about = about});
    it = seen.sources.end() - 1;
  }
  if (ClassOf(it->about) != EntityClass::kUser) it->about = about;
  it->last_ns = now_ns;
  it->first_packet = std::min(it->first_packet, traffic.first_packet);
  it->last_packet = std::max(it->last_packet, traffic.last_packet);
}

void WireWatch::Forget(int64_t now_ns) {
  while (!graves_.empty() && now_ns - graves_.front().first >= options_.tombstone_ns) {
    const auto [gone_ns, guid] = graves_.front();
    graves_.pop_front();
    // It may have come back since, and gone again.
    const auto writer = known_writers_.find(guid);
    if (writer != known_writers_.end() && writer->second.gone_ns == gone_ns) {
      known_writers_.erase(writer);
    }
    const auto participant = known_participants_.find(guid);
    if (participant != known_participants_.end() && participant->second.gone_ns == gone_ns) {
      for (const Locator& each : participant->second.advertised) {
        if (--advertised_[each] == 0) advertised_.erase(each);
      }
      known_participants_.erase(participant);
    }
  }
  absl::erase_if(forgeries_, [&](const auto& each) {
    return !Knows(each.first.second) && !known_writers_.contains(each.first.second);
  });
  const auto old = [&](int64_t last_ns) { return now_ns - last_ns >= options_.forget_ns; };
  absl::erase_if(conflicts_, [&](const auto& each) {
    return !known_writers_.contains(each.first) && old(each.second.last_ns);
  });
  for (auto it = participants_.begin(); it != participants_.end();) {
    Participant& seen = it->second;
    if (old(seen.last_ns)) {
      it = participants_.erase(it);
      continue;
    }
    if (Knows(it->first)) seen.whole.packets = 0;
    std::erase_if(seen.sources, [&](const Source& each) { return old(each.last_ns); });
    absl::erase_if(seen.writers, [&](const auto& each) {
      return known_writers_.contains(each.first) || old(each.second.last_ns);
    });
    ++it;
  }
}

// ----------------------------------------------------------------------------------- judgements

std::vector<sensor::Finding> WireWatch::Poll(bool settled, int64_t now_ns) {
  if (settled && settled_ns_ == 0) settled_ns_ = now_ns;
  if (settled_ns_ == 0 || now_ns < next_judgement_ns_) return {};
  next_judgement_ns_ = now_ns + options_.judge_interval_ns;
  Forget(now_ns);
  Findings found;
  for (const auto& [guid, seen] : participants_) {
    if (!blind_) JudgeUnknown(guid, seen, now_ns, found);
    JudgeSources(guid, seen, now_ns, found);
  }
  for (const auto& [key, finding] : found) {
    if (key.first != kSpoofedWriter || !IsThere(key.second)) continue;
    if (forgeries_.size() < options_.findings) forgeries_.try_emplace(key, finding);
  }
  found.insert(forgeries_.begin(), forgeries_.end());
  JudgeReception(now_ns, found);
  JudgeContents(found);
  return Tell(std::move(found));
}

void WireWatch::JudgeUnknown(const ros2::Guid& guid, const Participant& seen, int64_t now_ns,
                             Findings& found) const {
  const int64_t grace_ns =
      seen.announced && !Knows(guid) ? options_.announced_grace_ns : options_.grace_ns;
  const auto ripe = [&](const Suspect& suspect) {
    // It was leaving while we were still looking around.
    if (seen.announced && suspect.last_ns < settled_ns_) return false;
    return now_ns - std::max(suspect.first_ns, settled_ns_) >= grace_ns;
  };
  const auto add = [&](const ros2::Guid& about, const Suspect& suspect, absl::string_view what) {
    found[{kUnicastWriter, about}] = {
        .kind = kUnicastWriter,
        .guid = about,
        .detail = absl::StrCat("from ", ToString(suspect.from), " to ", ToString(suspect.to), ", ",
                               Datagrams(suspect.packets), ": ", what)};
  };
  for (const auto& [writer, suspect] : seen.writers) {
    if (ripe(suspect)) add(writer, suspect, "data of a writer that discovery does not show");
  }
  if (seen.whole.packets > 0 && seen.writers.empty() && ripe(seen.whole)) {
    add(guid, seen.whole, "a participant that discovery does not show");
  }
}

void WireWatch::JudgeSources(const ros2::Guid& guid, const Participant& seen, int64_t now_ns,
                             Findings& found) const {
  if (!Knows(guid)) return;
  const auto add = [&](const Source& source, absl::string_view why) {
    if (now_ns - std::max(source.first_ns, settled_ns_) < options_.grace_ns) return;
    found[{kSpoofedWriter, source.about}] = {
        .kind = kSpoofedWriter,
        .guid = source.about,
        .topic = TopicOf(source.about),
        .detail = absl::StrCat(ToString(source.from), " sends under this name, ", why)};
  };
  // Whoever uses this name may not claim another vendor for more.
  size_t ports_max = std::numeric_limits<size_t>::max();
  for (const Source& each : seen.sources) ports_max = std::min(ports_max, PortsOf(each.vendor));
  for (const Source& source : seen.sources) {
    if (!MaySendFrom(guid, seen, source.from.address)) {
      add(source, "an address that its participant does not advertise");
      continue;
    }
    // Others of that address that were there before and still are. A process that was started
    // again under its old name has left its old port.
    const Source* other = nullptr;
    size_t others = 0;
    for (const Source& each : seen.sources) {
      if (each.from.address != source.from.address || each.first_packet >= source.first_packet ||
          each.last_packet <= source.first_packet) {
        continue;
      }
      ++others;
      other = &each;
    }
    if (others >= ports_max) {
      add(source, absl::StrCat("which its participant uses from ", ToString(other->from)));
    }
  }
}

void WireWatch::JudgeReception(int64_t now_ns, Findings& found) {
  for (auto& [guid, writer] : known_writers_) {
    if (writer.reception == nullptr || !writer.reception->Missing(now_ns)) continue;
    found[{kDirectedData, guid}] = {
        .kind = kDirectedData,
        .guid = guid,
        .topic = writer.topic,
        .detail = absl::StrCat(writer.reception->missed(), " of ", writer.reception->sent(),
                               " samples on the wire do not come to our reader")};
  }
}

void WireWatch::JudgeContents(Findings& found) const {
  for (const auto& [guid, conflict] : conflicts_) {
    const auto writer = known_writers_.find(guid);
    if (writer == known_writers_.end()) continue;
    found[{kTwoContents, guid}] = {
        .kind = kTwoContents,
        .guid = guid,
        .topic = writer->second.topic,
        .detail = absl::StrCat("sample ", conflict.number, " goes to ", ToString(conflict.to),
                               " with another content than elsewhere")};
  }
}

std::vector<sensor::Finding> WireWatch::Tell(Findings found) {
  std::vector<sensor::Finding> told;
  for (auto it = standing_.begin(); it != standing_.end();) {
    if (found.contains(it->first)) {
      ++it;
      continue;
    }
    it->second.over = true;
    told.push_back(std::move(it->second));
    it = standing_.erase(it);
  }
  for (auto& [key, finding] : found) {
    if (standing_.contains(key)) continue;
    if (full()) {
      ++counters_.findings_dropped;
      continue;
    }
    told.push_back(finding);
    standing_.emplace(key, std::move(finding));
  }
  return told;
}

}  // namespace rips::wire
