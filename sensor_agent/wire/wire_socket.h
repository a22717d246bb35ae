// The sensor's end of the local socket on which rips-wire reports.
#ifndef RIPS_SENSOR_AGENT_WIRE_WIRE_SOCKET_H_
#define RIPS_SENSOR_AGENT_WIRE_WIRE_SOCKET_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sensor_agent/wire/traffic.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/unique_fd.h"

namespace rips::wire {

struct WireSocketOptions {
  std::string path;
  uint32_t domain = 0;
  // Reports not yet taken; beyond, the oldest is lost and counted.
  size_t reports = 256;
};

// A report, or that a tap has connected, whose counts begin anew.
struct Received {
  bool connected = false;
  TapReport report;
};

// Listens on a thread of its own, for one tap at a time: of root or of our own user, and of our
// domain. Who sends anything else is cut off, with a log line.
class WireSocket {
 public:
  // InvalidArgument if `path` is too long for a socket; AlreadyExists if somebody listens there;
  // the system's error if it cannot be made, PermissionDenied or NotFound for its directory. What
  // is left there of a sensor that has died is replaced. `wake` is called on the thread when there
  // is something to take; it must not block.
  static absl::StatusOr<std::unique_ptr<WireSocket>> Listen(WireSocketOptions options,
                                                            std::function<void()> wake);
  // Joins the thread, and removes the path.
  ~WireSocket();
  WireSocket(const WireSocket&) = delete;
  WireSocket& operator=(const WireSocket&) = delete;

  // In order. Any thread.
  std::vector<Received> Take() { return received_.PopAll(absl::ZeroDuration()); }
  // A tap is connected. Any thread.
  bool connected() const { return connected_; }
  // Reports lost because they were not taken in time.
  uint64_t dropped() const { return received_.dropped(); }

 private:
  WireSocket(WireSocketOptions options, std::function<void()> wake, UniqueFd listener,
             UniqueFd stop);

  void Run();
  void Accept();
  // False when the connection is over.
  bool ReadReport();
  void Disconnect();

  const WireSocketOptions options_;
  const std::function<void()> wake_;
  BoundedQueue<Received> received_;
  std::atomic<bool> connected_ = false;
  UniqueFd listener_;
  UniqueFd stop_;
  // The thread's.
  UniqueFd tap_;
  std::string buffer_;
  std::thread thread_;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_WIRE_SOCKET_H_
