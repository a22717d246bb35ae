#include "sensor_agent/wire/traffic.h"

#include <algorithm>
#include <tuple>

namespace rips::wire {

namespace {

void TakeLeast(uint64_t number, bool first, uint64_t& least) {
  least = first ? number : std::min(least, number);
}

void Count(const RtpsSubmessage& submessage, Traffic& traffic) {
  traffic.dropped_last = std::max(traffic.dropped_last, submessage.dropped);
  switch (submessage.kind) {
    case RtpsSubmessage::Kind::kGap:
      return;
    case RtpsSubmessage::Kind::kHeartbeat:
      // Zero says nothing: some send it to every new reader.
      if (submessage.sequence > 0) {
        TakeLeast(submessage.sequence, traffic.heartbeat_least == 0, traffic.heartbeat_least);
      }
      ++traffic.heartbeat;
      traffic.heartbeat_last = std::max(traffic.heartbeat_last, submessage.sequence);
      return;
    case RtpsSubmessage::Kind::kData:
    case RtpsSubmessage::Kind::kDataFrag:
      break;
  }
  TakeLeast(submessage.sequence, traffic.data_least == 0, traffic.data_least);
  ++(submessage.kind == RtpsSubmessage::Kind::kData ? traffic.data : traffic.data_frag);
  if (submessage.directed) ++traffic.directed;
  traffic.data_last = std::max(traffic.data_last, submessage.sequence);
  traffic.numbers.Add(submessage.sequence);
}

bool IsUsersData(const RtpsSubmessage& submessage) {
  return (submessage.kind == RtpsSubmessage::Kind::kData ||
          submessage.kind == RtpsSubmessage::Kind::kDataFrag) &&
         ClassOf(submessage.writer) == EntityClass::kUser;
}

}  // namespace

void TrafficTable::Add(const RtpsDatagram& datagram, const Locator& source, const Locator& to,
                       int64_t now_ns) {
  const uint64_t number = ++counters_.packets;
  if (datagram.malformed) ++counters_.malformed;
  if (datagram.cut) ++counters_.cut;
  bool dropped = false;
  const auto obtain = [&](const ros2::Guid& writer) -> Traffic* {
    Traffic* traffic = Obtain(writer, source);
    if (traffic == nullptr) {
      dropped = true;
    } else if (traffic->last_packet != number) {
      Count(datagram, to, number, *traffic);
    }
    return traffic;
  };
  // The sender has its say even if all its submessages name another (INFO_SRC).
  bool sender_named = false;
  for (const RtpsSubmessage& submessage : datagram.submessages) {
    sender_named = sender_named || submessage.writer.SamePrefix(datagram.sender);
    Traffic* traffic = obtain(submessage.writer);
    if (traffic == nullptr) continue;
    wire::Count(submessage, *traffic);
    if (!IsUsersData(submessage) || !contents_.Differs(submessage, now_ns)) continue;
    ++traffic->conflicts;
    traffic->conflict_number = submessage.sequence;
    traffic->conflict_size = submessage.content_size;
    traffic->conflict_to = to;
  }
  if (!sender_named) obtain(datagram.sender);
  if (dropped) ++counters_.table_drops;
}

Traffic* TrafficTable::Obtain(const ros2::Guid& writer, const Locator& source) {
  const auto it = entries_.find(Key(writer, source));
  if (it != entries_.end()) return &it->second;
  if (entries_.size() >= limits_.entries) return nullptr;
  Traffic& traffic = entries_[Key(writer, source)];
  traffic.writer = writer;
  traffic.source = source;
  return &traffic;
}

void TrafficTable::Count(const RtpsDatagram& datagram, const Locator& to, uint64_t number,
                         Traffic& traffic) {
  if (traffic.packets == 0) traffic.first_packet = number;
  traffic.last_packet = number;
  traffic.vendor = datagram.vendor;
  ++traffic.packets;
  if (datagram.secured) ++traffic.secured;
  for (Destination& destination : traffic.destinations) {
    if (destination.to != to) continue;
    ++destination.packets;
    return;
  }
  if (traffic.destinations.size() < kDestinationsMax) {
    traffic.destinations.push_back({.to = to, .packets = 1});
  } else {
    ++traffic.elsewhere;
  }
}

std::vector<Traffic> TrafficTable::Take() {
  std::vector<Traffic> taken;
  taken.reserve(entries_.size());
  for (auto& [key, traffic] : entries_) taken.push_back(std::move(traffic));
  entries_.clear();
  std::sort(taken.begin(), taken.end(), [](const Traffic& a, const Traffic& b) {
    return std::tie(a.writer, a.source) < std::tie(b.writer, b.source);
  });
  return taken;
}

}  // namespace rips::wire
