// gRPC's own log lines.
#ifndef RIPS_SERVICES_RPC_GRPC_LOGS_H_
#define RIPS_SERVICES_RPC_GRPC_LOGS_H_

namespace rips::rpc {

// Sends what gRPC logs to services/runtime/log.h at debug level: what matters of it reaches the
// daemon as a status, and is logged there. Call first in main().
void RouteGrpcLogs();

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_GRPC_LOGS_H_
