// The Unix socket of rips-fw: who may ask, and packets in and out.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_FW_FW_SERVER_H_
#define RIPS_MODE_ACTUATOR_HELPERS_FW_FW_SERVER_H_

#include <sys/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/firewall/fw_message.h"
#include "services/local_socket/helper_socket.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips::actuator {

inline constexpr size_t kFwConnectionsMax = 16;
// A connection that says nothing is closed after this.
inline constexpr absl::Duration kFwIdleMax = absl::Seconds(30);

class FwServer {
 public:
  using Handler = std::function<FwResponse(const FwRequest&)>;

  // Only root and `user` are served; the kernel says who they are. `handler` is called by Run, one
  // request at a time.
  FwServer(UniqueFd listener, uid_t user, Handler handler);

  // Serves until Stop.
  void Run();
  // Any thread.
  void Stop() { stop_.Wake(); }

 private:
  struct Connection {
    UniqueFd fd;
    int64_t last_ns = 0;
  };

  void Accept();
  // False if the connection is to be closed.
  bool Serve(int fd);

  const UniqueFd listener_;
  const WakeFd stop_;
  const uid_t user_;
  const Handler handler_;
  std::vector<Connection> connections_;  // of the thread in Run
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_FW_FW_SERVER_H_
