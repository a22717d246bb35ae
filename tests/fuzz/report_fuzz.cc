// Whatever comes through the socket of rips-wire: a report is refused or decoded; encoded anew it
// fits into packets, and these decode to the same.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "sensor_agent/wire/report_codec.h"
#include "services/base/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips::wire;  // One translation unit, nothing else in it.
  const std::string input(reinterpret_cast<const char*>(data), size);
  const auto report = DecodeReport(input);
  if (!report.ok()) return 0;
  RIPS_CHECK(report->boottime_ns >= 0, "a time before the host was started");
  RIPS_CHECK(report->local_addresses.size() <= kLocalAddressesMax, "past a limit");
  TapReport again = {.domain = report->domain,
                     .boottime_ns = report->boottime_ns,
                     .counters = report->counters,
                     .local_addresses = report->local_addresses};
  for (const std::string& bytes : EncodeReports(*report)) {
    RIPS_CHECK(bytes.size() <= kReportBytesMax, "a report does not fit into a packet");
    const auto part = DecodeReport(bytes);
    RIPS_CHECK(part.ok(), "a report of ours is refused");
    again.traffic.insert(again.traffic.end(), part->traffic.begin(), part->traffic.end());
  }
  RIPS_CHECK(again == *report, "a report changed on its way");
  return 0;
}
