#include "sensor_agent/wire/report_codec.h"

#include <algorithm>
#include <limits>

#include "absl/strings/str_cat.h"
#include "rips/v1/wire.pb.h"
#include "services/base/status_macros.h"

namespace rips::wire {

namespace {

constexpr uint32_t kU16Max = std::numeric_limits<uint16_t>::max();
// Of RTPS; it leaves room to count on.
constexpr uint64_t kSequenceMax = std::numeric_limits<int64_t>::max();

std::string ToBytes(const Address& address) {
  return std::string(address.bytes.begin(), address.bytes.end());
}

void Encode(const Locator& locator, rips::v1::WireLocator& wire) {
  wire.set_address(ToBytes(locator.address));
  wire.set_port(locator.port);
}

void Encode(const Traffic& traffic, rips::v1::WireTraffic& wire) {
  wire.set_writer_guid(traffic.writer.ToBytes());
  Encode(traffic.source, *wire.mutable_source());
  wire.set_vendor(traffic.vendor);
  wire.set_packets(traffic.packets);
  wire.set_data(traffic.data);
  wire.set_data_frag(traffic.data_frag);
  wire.set_heartbeat(traffic.heartbeat);
  wire.set_directed(traffic.directed);
  wire.set_secured(traffic.secured);
  wire.set_data_last(traffic.data_last);
  wire.set_heartbeat_last(traffic.heartbeat_last);
  wire.set_first_packet(traffic.first_packet);
  wire.set_last_packet(traffic.last_packet);
  for (const Destination& destination : traffic.destinations) {
    rips::v1::WireDestination& to = *wire.add_destinations();
    Encode(destination.to, *to.mutable_to());
    to.set_packets(destination.packets);
  }
  wire.set_elsewhere(traffic.elsewhere);
  wire.set_data_least(traffic.data_least);
  wire.set_heartbeat_least(traffic.heartbeat_least);
  wire.set_dropped_last(traffic.dropped_last);
  for (const NumberRun& run : traffic.numbers.runs()) {
    rips::v1::WireNumbers& numbers = *wire.add_numbers();
    numbers.set_first(run.first);
    numbers.set_last(run.last);
  }
  if (traffic.conflicts == 0) return;
  rips::v1::WireConflict& conflict = *wire.mutable_conflict();
  conflict.set_count(traffic.conflicts);
  conflict.set_number(traffic.conflict_number);
  conflict.set_size(traffic.conflict_size);
  Encode(traffic.conflict_to, *conflict.mutable_to());
}

rips::v1::WireReport EncodeHead(const TapReport& report) {
  rips::v1::WireReport wire;
  wire.set_domain(report.domain);
  wire.set_boottime_ns(static_cast<uint64_t>(report.boottime_ns));
  wire.set_packets(report.counters.packets);
  wire.set_malformed(report.counters.malformed);
  wire.set_cut(report.counters.cut);
  wire.set_kernel_drops(report.counters.kernel_drops);
  wire.set_table_drops(report.counters.table_drops);
  const size_t addresses = std::min(report.local_addresses.size(), kLocalAddressesMax);
  for (size_t i = 0; i < addresses; ++i) {
    wire.add_local_addresses(ToBytes(report.local_addresses[i]));
  }
  return wire;
}

absl::Status OutOfRange(absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("the ", what, " of a report is out of range"));
}

absl::StatusOr<Address> DecodeAddress(const std::string& bytes) {
  Address address;
  if (bytes.size() != address.bytes.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("an address has ", address.bytes.size(), " bytes, not ", bytes.size()));
  }
  std::copy(bytes.begin(), bytes.end(), address.bytes.begin());
  return address;
}

absl::StatusOr<Locator> Decode(const rips::v1::WireLocator& wire) {
  RIPS_ASSIGN_OR_RETURN(const Address address, DecodeAddress(wire.address()));
  if (wire.port() > kU16Max) return OutOfRange("port");
  return Locator{.address = address, .port = static_cast<uint16_t>(wire.port())};
}

absl::StatusOr<Traffic> Decode(const rips::v1::WireTraffic& wire) {
  Traffic traffic;
  RIPS_ASSIGN_OR_RETURN(traffic.writer, ros2::GuidFromBytes(wire.writer_guid()));
  RIPS_ASSIGN_OR_RETURN(traffic.source, Decode(wire.source()));
  if (wire.vendor() > kU16Max) return OutOfRange("vendor");
  traffic.vendor = static_cast<uint16_t>(wire.vendor());
  traffic.packets = wire.packets();
  traffic.data = wire.data();
  traffic.data_frag = wire.data_frag();
  traffic.heartbeat = wire.heartbeat();
  traffic.directed = wire.directed();
  traffic.secured = wire.secured();
  traffic.data_last = wire.data_last();
  traffic.heartbeat_last = wire.heartbeat_last();
  traffic.first_packet = wire.first_packet();
  traffic.last_packet = wire.last_packet();
  if (static_cast<size_t>(wire.destinations_size()) > kDestinationsMax) {
    return OutOfRange("number of destinations");
  }
  for (const rips::v1::WireDestination& to : wire.destinations()) {
    RIPS_ASSIGN_OR_RETURN(const Locator locator, Decode(to.to()));
    traffic.destinations.push_back({.to = locator, .packets = to.packets()});
  }
  traffic.elsewhere = wire.elsewhere();
  traffic.data_least = wire.data_least();
  traffic.heartbeat_least = wire.heartbeat_least();
  traffic.dropped_last = wire.dropped_last();
  for (const uint64_t number : {traffic.data_last, traffic.heartbeat_last, traffic.dropped_last}) {
    if (number > kSequenceMax) return OutOfRange("sequence number");
  }
  if (static_cast<size_t>(wire.numbers_size()) > kRunsMax) {
    return OutOfRange("number of runs");
  }
  for (const rips::v1::WireNumbers& run : wire.numbers()) {
    if (run.first() == 0 || run.last() < run.first() || run.last() > kSequenceMax) {
      return OutOfRange("sequence number");
    }
    traffic.numbers.Add({.first = run.first(), .last = run.last()});
  }
  if (!wire.has_conflict()) return traffic;
  traffic.conflicts = wire.conflict().count();
  traffic.conflict_number = wire.conflict().number();
  traffic.conflict_size = wire.conflict().size();
  RIPS_ASSIGN_OR_RETURN(traffic.conflict_to, Decode(wire.conflict().to()));
  return traffic;
}

}  // namespace

std::vector<std::string> EncodeReports(const TapReport& report) {
  std::vector<std::string> encoded;
  size_t next = 0;
  do {
    rips::v1::WireReport wire = EncodeHead(report);
    const size_t end = std::min(next + kReportTrafficMax, report.traffic.size());
    for (; next < end; ++next) Encode(report.traffic[next], *wire.add_traffic());
    encoded.push_back(wire.SerializeAsString());
  } while (next < report.traffic.size());
  return encoded;
}

absl::StatusOr<TapReport> DecodeReport(absl::string_view bytes) {
  if (bytes.size() > kReportBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("a report of ", bytes.size(), " bytes exceeds limit ", kReportBytesMax));
  }
  rips::v1::WireReport wire;
  if (!wire.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) {
    return absl::InvalidArgumentError("not a report");
  }
  if (wire.boottime_ns() > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) {
    return OutOfRange("time");
  }
  if (static_cast<size_t>(wire.local_addresses_size()) > kLocalAddressesMax) {
    return OutOfRange("number of local addresses");
  }
  TapReport report{.domain = wire.domain(),
                   .boottime_ns = static_cast<int64_t>(wire.boottime_ns()),
                   .counters = {.packets = wire.packets(),
                                .malformed = wire.malformed(),
                                .cut = wire.cut(),
                                .kernel_drops = wire.kernel_drops(),
                                .table_drops = wire.table_drops()}};
  for (const std::string& each : wire.local_addresses()) {
    RIPS_ASSIGN_OR_RETURN(const Address address, DecodeAddress(each));
    report.local_addresses.push_back(address);
  }
  for (const rips::v1::WireTraffic& each : wire.traffic()) {
    RIPS_ASSIGN_OR_RETURN(Traffic traffic, Decode(each));
    report.traffic.push_back(std::move(traffic));
  }
  return report;
}

}  // namespace rips::wire
