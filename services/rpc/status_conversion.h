// absl::Status and grpc::Status carry the same codes.
#ifndef RIPS_SERVICES_RPC_STATUS_CONVERSION_H_
#define RIPS_SERVICES_RPC_STATUS_CONVERSION_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "grpcpp/support/status.h"

namespace rips::rpc {

// Messages are cut at this many bytes: they travel as HTTP/2 metadata, percent-encoded (up to
// three times as long), whose limit is 8 KiB.
inline constexpr size_t kStatusMessageBytesMax = 2048;

// Begins the message of a call that was refused for the rate of its caller, before anything was
// done for it: the same call may be made a little later.
inline constexpr absl::string_view kCalledTooOften = "this certificate began more than ";

grpc::Status ToGrpc(const absl::Status& status);
absl::Status FromGrpc(const grpc::Status& status);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_STATUS_CONVERSION_H_
