// Lets a domain end whose address has gone from the host.
//
// When a domain ends, Cyclone wakes the threads that wait for datagrams by sending one to the
// address that its interface had at the start. If the host has another one by then, nothing comes
// and the end waits for ever. Their sockets are bound to a port of every address, so a datagram by
// way of the loopback interface wakes them as well.
#ifndef RIPS_SERVICES_DDS_RECEIVER_WAKER_H_
#define RIPS_SERVICES_DDS_RECEIVER_WAKER_H_

#include "absl/time/time.h"
#include "services/runtime/ticker.h"

namespace rips::dds {

// While it lives, and from `after` on, each UDP socket of this process that is bound to every
// address is sent an octet now and then, which no protocol takes for a message.
class ReceiverWaker {
 public:
  explicit ReceiverWaker(absl::Duration after = absl::Seconds(1));

 private:
  Ticker ticker_;
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_RECEIVER_WAKER_H_
