#include "services/rpc/grpc_logs.h"

#include "grpc/support/log.h"
#include "services/runtime/log.h"

namespace rips::rpc {

void RouteGrpcLogs() {
  gpr_set_log_function([](gpr_log_func_args* args) {
    LogDebug("grpc", {{"text", args->message}, {"file", args->file}, {"line", args->line}});
  });
}

}  // namespace rips::rpc
