#include "services/ros2/service_header.h"

#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"

namespace rips::ros2 {
namespace {

constexpr size_t kServiceHeaderBytes = 16;

}  // namespace

absl::StatusOr<std::string> AddServiceHeader(absl::string_view payload,
                                             const ServiceHeader& header) {
  if (const CdrReader reader(payload); !reader.ok()) {
    return absl::InvalidArgumentError(reader.status().message());
  }
  CdrWriter writer(payload[1] == 0 ? ByteOrder::kBig : ByteOrder::kLittle);
  writer.U64(header.client_id);
  writer.I64(header.sequence);
  writer.Octets(payload.substr(kCdrHeaderBytes));
  return std::move(writer).Finish();
}

absl::StatusOr<ServiceMessage> SplitServiceHeader(absl::string_view payload) {
  CdrReader reader(payload);
  ServiceMessage message;
  message.header.client_id = reader.U64();
  message.header.sequence = reader.I64();
  RIPS_RETURN_IF_ERROR(reader.status());
  message.payload = absl::StrCat(payload.substr(0, kCdrHeaderBytes),
                                 payload.substr(kCdrHeaderBytes + kServiceHeaderBytes));
  return message;
}

}  // namespace rips::ros2
