// TapReport as rips.v1.WireReport and back.
#ifndef RIPS_SENSOR_AGENT_WIRE_REPORT_CODEC_H_
#define RIPS_SENSOR_AGENT_WIRE_REPORT_CODEC_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "sensor_agent/wire/traffic.h"

namespace rips::wire {

// Bytes of one report on the socket; a longer one is refused.
inline constexpr size_t kReportBytesMax = 64 * 1024;
// Traffic of one report: such a report is always shorter than that.
inline constexpr size_t kReportTrafficMax = 64;
inline constexpr size_t kLocalAddressesMax = 256;

// `report` in as many serialized WireReports as needed, at least one. Local addresses beyond
// kLocalAddressesMax are left out.
std::vector<std::string> EncodeReports(const TapReport& report);

// InvalidArgument: no WireReport, a limit exceeded, a GUID or address of the wrong length, a port,
// vendor, time or sequence number out of range. The text is safe to log.
absl::StatusOr<TapReport> DecodeReport(absl::string_view bytes);

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_REPORT_CODEC_H_
