#include "sensor_agent/wire/report_codec.h"

#include <limits>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "rips/v1/wire.pb.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "services/base/status_matchers.h"

namespace rips::wire {
namespace {

using ::testing::SizeIs;

constexpr uint64_t kMax = std::numeric_limits<uint64_t>::max();
constexpr uint64_t kSequenceMax = std::numeric_limits<int64_t>::max();

// With the greatest values there are, as long as a report can be.
Traffic Greatest(uint32_t number) {
  Address address;
  address.bytes.fill(0xff);
  const Locator locator = {.address = address, .port = 65'535};
  NumberSet numbers(kRunsMax, /*keep=*/true);
  for (uint64_t i = 0; i < kRunsMax; ++i) {
    numbers.Add(NumberRun{.first = kSequenceMax - 3 * i - 1, .last = kSequenceMax - 3 * i});
  }
  return {.writer = TestGuid(1, number),
          .source = locator,
          .vendor = 65'535,
          .packets = kMax,
          .data = kMax,
          .data_frag = kMax,
          .heartbeat = kMax,
          .directed = kMax,
          .secured = kMax,
          .data_last = kSequenceMax,
          .heartbeat_last = kSequenceMax,
          .first_packet = kMax,
          .last_packet = kMax,
          .destinations = std::vector<Destination>(kDestinationsMax, {locator, kMax}),
          .elsewhere = kMax,
          .data_least = kSequenceMax,
          .heartbeat_least = kSequenceMax,
          .dropped_last = kSequenceMax,
          .numbers = numbers,
          .conflicts = kMax,
          .conflict_number = kSequenceMax,
          .conflict_size = std::numeric_limits<uint32_t>::max(),
          .conflict_to = locator};
}

TapReport Report(size_t traffic) {
  TapReport report{.domain = 42,
                   .boottime_ns = std::numeric_limits<int64_t>::max(),
                   .counters = {kMax, kMax, kMax, kMax, kMax},
                   .local_addresses = std::vector<Address>(kLocalAddressesMax)};
  for (size_t i = 0; i < traffic; ++i) report.traffic.push_back(Greatest(static_cast<uint32_t>(i)));
  return report;
}

TEST(ReportCodecTest, DecodesWhatItEncodes) {
  for (const size_t traffic : {size_t{0}, size_t{1}, kReportTrafficMax}) {
    const std::vector<std::string> encoded = EncodeReports(Report(traffic));

    ASSERT_THAT(encoded, SizeIs(1));
    EXPECT_LE(encoded[0].size(), kReportBytesMax);
    const auto decoded = DecodeReport(encoded[0]);
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(*decoded, Report(traffic));
  }
}

TEST(ReportCodecTest, SplitsALongReport) {
  TapReport report = Report(2 * kReportTrafficMax + 1);
  const std::vector<std::string> encoded = EncodeReports(report);

  ASSERT_THAT(encoded, SizeIs(3));
  std::vector<Traffic> together;
  for (const std::string& each : encoded) {
    const auto part = DecodeReport(each);
    ASSERT_THAT(part, IsOk());
    EXPECT_EQ(part->counters, report.counters);
    together.insert(together.end(), part->traffic.begin(), part->traffic.end());
  }
  EXPECT_EQ(together, report.traffic);
}

TEST(ReportCodecTest, LeavesOutLocalAddressesBeyondTheLimit) {
  TapReport report = Report(0);
  report.local_addresses.emplace_back();

  const auto decoded = DecodeReport(EncodeReports(report)[0]);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(*decoded, Report(0));
}

TEST(ReportCodecTest, CutAnywhereAReportIsRefusedOrShorter) {
  const std::string whole = EncodeReports(Report(2))[0];
  for (size_t bytes = 0; bytes < whole.size(); ++bytes) {
    const auto report = DecodeReport(absl::string_view(whole).substr(0, bytes));
    EXPECT_FALSE(report.ok() && *report == Report(2)) << bytes;
  }
}

TEST(ReportCodecTest, RefusesWhatMakesNoSense) {
  struct Case {
    std::string text;
    void (*spoil)(rips::v1::WireReport&);
  };
  const Case cases[] = {
      {"a GUID has 16 bytes, not 15",
       [](auto& wire) { wire.mutable_traffic(0)->set_writer_guid(std::string(15, 'g')); }},
      {"an address has 16 bytes, not 4",
       [](auto& wire) { wire.mutable_traffic(0)->mutable_source()->set_address("abcd"); }},
      {"an address has 16 bytes, not 0",
       [](auto& wire) { wire.mutable_traffic(0)->clear_source(); }},
      {"the port of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->mutable_source()->set_port(65'536); }},
      {"the port of a report is out of range",
       [](auto& wire) {
         wire.mutable_traffic(0)->mutable_destinations(0)->mutable_to()->set_port(65'536);
       }},
      {"the vendor of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->set_vendor(65'536); }},
      {"the number of destinations of a report is out of range",
       [](auto& wire) {
         *wire.mutable_traffic(0)->add_destinations() = wire.traffic(0).destinations(0);
       }},
      {"the sequence number of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->set_data_last(uint64_t{1} << 63); }},
      {"the sequence number of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->set_dropped_last(kMax); }},
      {"the sequence number of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->mutable_numbers(0)->set_last(kMax); }},
      {"the sequence number of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->mutable_numbers(0)->set_last(1); }},
      {"the sequence number of a report is out of range",
       [](auto& wire) { wire.mutable_traffic(0)->mutable_numbers(0)->set_first(0); }},
      {"the number of runs of a report is out of range",
       [](auto& wire) { *wire.mutable_traffic(0)->add_numbers() = wire.traffic(0).numbers(0); }},
      {"an address has 16 bytes, not 0",
       [](auto& wire) { wire.mutable_traffic(0)->mutable_conflict()->clear_to(); }},
      {"the time of a report is out of range",
       [](auto& wire) { wire.set_boottime_ns(uint64_t{1} << 63); }},
      {"the number of local addresses of a report is out of range",
       [](auto& wire) { wire.add_local_addresses(std::string(16, 'a')); }},
      {"an address has 16 bytes, not 3", [](auto& wire) { wire.set_local_addresses(0, "abc"); }},
  };
  for (const Case& each : cases) {
    rips::v1::WireReport wire;
    ASSERT_TRUE(wire.ParseFromString(EncodeReports(Report(1))[0]));
    each.spoil(wire);

    const auto report = DecodeReport(wire.SerializeAsString());
    EXPECT_EQ(report.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(report.status().message(), each.text);
  }
}

TEST(ReportCodecTest, RefusesOtherBytesAndMoreOfThemThanAReportHas) {
  EXPECT_EQ(DecodeReport("\xff\xff").status().message(), "not a report");
  EXPECT_EQ(DecodeReport(std::string(kReportBytesMax + 1, '\0')).status().message(),
            "a report of 65537 bytes exceeds limit 65536");
  EXPECT_EQ(DecodeReport(std::string(kReportBytesMax, '\xff')).status().message(), "not a report");
}

}  // namespace
}  // namespace rips::wire
