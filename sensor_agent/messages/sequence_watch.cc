#include "sensor_agent/messages/sequence_watch.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::sensor {

namespace {

using ros2::Guid;

// Endpoints that a participant announces, and messages of ros_discovery_info.
constexpr uint64_t kFirstOfDiscoveryMax = 10'000'000;
constexpr uint64_t kFirstOfLatchedMax = 10'000'000'000;
// Of these, and of a writer that keeps samples for late readers.
constexpr uint64_t kDiscoveryPerSecond = 10'000;
constexpr uint64_t kKeptPerSecond = 100'000;
// Looks that show drops alone. A writer that keeps its samples may write one and fall silent.
constexpr int kStuckLooks = 2;
constexpr int64_t kQuietNs = 2'000'000'000;

// SEDPbuiltinPublicationsWriter and SEDPbuiltinSubscriptionsWriter (DDSI-RTPS 2.5 §9.3.1.5).
constexpr uint8_t kDiscoveryWriters[] = {0x03, 0x04};

Guid DiscoveryWriter(const Guid& participant, uint8_t number) {
  Guid guid = participant.Participant();
  guid.bytes[12] = 0;
  guid.bytes[13] = 0;
  guid.bytes[14] = number;
  guid.bytes[15] = 0xc2;
  return guid;
}

// A writer of the middleware itself, which discovery does not show by itself.
bool IsBuiltin(const Guid& writer) { return (writer.bytes[15] & 0xc0) == 0xc0; }

bool Keeps(WriterKind kind) {
  return kind == WriterKind::kLatched || kind == WriterKind::kDiscovery;
}

uint64_t FirstMax(WriterKind kind) {
  if (kind == WriterKind::kDiscovery) return kFirstOfDiscoveryMax;
  return kind == WriterKind::kLatched ? kFirstOfLatchedMax : kFirstNumberMax;
}

uint64_t PerSecond(WriterKind kind) {
  if (kind == WriterKind::kDiscovery) return kDiscoveryPerSecond;
  return kind == WriterKind::kLatched ? kKeptPerSecond : kNumbersPerSecond;
}

// 0 = nothing has come; then a reliable writer may have been asked for its first sample.
uint64_t TopOf(const HeldNumbers& held) {
  if (held.next <= 1 && held.last <= 1) return 0;
  return std::max(held.next > 0 ? held.next - 1 : 0, held.last);
}

}  // namespace

SequenceWatch::SequenceWatch(SequenceWatchOptions options, Numbers numbers, Forget forget)
    : options_(options), numbers_(std::move(numbers)), forget_(std::move(forget)) {}

void SequenceWatch::ParticipantSeen(const Guid& participant) {
  for (const uint8_t number : kDiscoveryWriters) {
    WriterSeen(DiscoveryWriter(participant, number), WriterKind::kDiscovery);
  }
}

void SequenceWatch::WriterSeen(const Guid& writer, WriterKind kind) {
  const size_t room = kind == WriterKind::kUnread ? options_.writers / 2 : options_.writers;
  if (writers_.size() >= room && !writers_.contains(writer)) return;
  writers_[writer].kind = kind;
  if (const auto early = early_.find(writer); early != early_.end()) {
    Jump(writer, writers_[writer], std::move(early->second));
    early_.erase(early);
  }
}

void SequenceWatch::WriterGone(const Guid& writer) {
  writers_.erase(writer);
  early_.erase(writer);
}

void SequenceWatch::ParticipantGone(const Guid& participant) {
  Guid first = participant;
  std::fill(first.bytes.begin() + 12, first.bytes.end(), uint8_t{0});
  auto it = writers_.lower_bound(first);
  while (it != writers_.end() && it->first.SamePrefix(participant)) it = writers_.erase(it);
  auto early = early_.lower_bound(first);
  while (early != early_.end() && early->first.SamePrefix(participant)) {
    early = early_.erase(early);
  }
}

void SequenceWatch::Jumped(const SequenceJump& jump) {
  auto it = writers_.find(jump.writer);
  if (it == writers_.end() && IsBuiltin(jump.writer) &&
      writers_.contains(DiscoveryWriter(jump.writer, kDiscoveryWriters[0]))) {
    it = writers_.emplace(jump.writer, Writer{}).first;
  }
  if (it != writers_.end()) {
    Jump(jump.writer, it->second, jump.detail);
  } else if (early_.size() < options_.early) {
    early_.emplace(jump.writer, jump.detail);
  }
}

void SequenceWatch::Jump(const Guid& guid, Writer& writer, std::string detail) {
  writer.forget = writer.kind != WriterKind::kUnread;
  if (std::exchange(writer.jumped, true)) return;
  jumps_.push_back({.writer = guid, .detail = std::move(detail)});
}

bool SequenceWatch::MayForget(Writer& writer, int64_t now_ns) const {
  if (writer.pause_ns == 0 || now_ns - writer.forgot_ns >= options_.calm_ns) {
    writer.pause_ns = options_.pause_ns;
    return true;
  }
  if (now_ns - writer.forgot_ns < writer.pause_ns) return false;
  writer.pause_ns = std::min(2 * writer.pause_ns, options_.pause_max_ns);
  return true;
}

void SequenceWatch::LookForDrops(Writer& writer, const HeldNumbers& held, int64_t now_ns) const {
  if (held.next != writer.held.next) {
    writer.next_ns = now_ns;
    writer.stuck = 0;
    return;
  }
  if (held.discarded <= writer.held.discarded) return;
  ++writer.stuck;
  const bool quiet = Keeps(writer.kind) && now_ns - writer.next_ns >= kQuietNs;
  if (writer.stuck < kStuckLooks && !quiet) return;
  writer.forget = true;
  writer.before = TopOf(held);
  writer.looks_since = 0;
}

void SequenceWatch::Look(const Guid& guid, Writer& writer, int64_t now_ns) {
  const std::optional<HeldNumbers> held = numbers_(guid);
  if (!held.has_value()) {
    writer.looked = false;
    writer.before = 0;
    return;
  }
  const uint64_t top = TopOf(*held);
  bool believed = true;
  if (!writer.looked) {
    writer.next_ns = writer.top_ns = now_ns;
    writer.top = 0;
    believed = top <= FirstMax(writer.kind);
    if (!believed) Jump(guid, writer, absl::StrCat("its first number is ", top));
  } else if (top > writer.top) {
    const bool first = writer.top == 0 && top <= FirstMax(writer.kind);
    believed = first || top - writer.top <= RiseMax(PerSecond(writer.kind), now_ns - writer.top_ns);
    if (!believed) {
      Jump(guid, writer, absl::StrCat("its numbers jumped from ", writer.top, " to ", top));
    }
  }
  if (writer.looked && believed && !writer.forget) {
    LookForDrops(writer, *held, now_ns);
    if (writer.before > 0 && !writer.forget && top > 0) {
      const bool back = writer.before > top && writer.before - top > kNumbersSlack;
      if (back && ++writer.looks_since >= 2) {
        Jump(guid, writer, absl::StrCat("its numbers went back from ", writer.before, " to ", top));
        writer.forget = false;
        writer.before = 0;
      } else if (!back) {
        writer.before = 0;
      }
    }
  }
  if (believed && top != writer.top && top > 0) {
    writer.top = top;
    writer.top_ns = now_ns;
  }
  writer.held = *held;
  writer.looked = true;
}

std::vector<SequenceJump> SequenceWatch::Poll(int64_t now_ns) {
  if (now_ns >= next_look_ns_) {
    next_look_ns_ = now_ns + options_.look_interval_ns;
    size_t forgets = options_.forgets;
    for (auto& [guid, writer] : writers_) {
      if (writer.kind == WriterKind::kUnread) continue;
      Look(guid, writer, now_ns);
      if (!writer.forget || forgets == 0 || !MayForget(writer, now_ns)) continue;
      --forgets;
      writer.forget = false;
      writer.forgot_ns = now_ns;
      writer.stuck = 0;
      forget_(guid);
      // Its numbers begin again, and what was dropped before does not count.
      writer.held = numbers_(guid).value_or(HeldNumbers{});
    }
  }
  return std::exchange(jumps_, {});
}

}  // namespace rips::sensor
