#include "tests/support/dds_peer/withhold.h"

#include <arpa/inet.h>
#include <dlfcn.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cstdint>
#include <cstring>
#include <string>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace rips::dds_peer {
namespace {

// Port 0 = nothing is withheld.
sockaddr_in withheld = {};

bool IsWithheld(const msghdr& message) {
  if (withheld.sin_port == 0 || message.msg_namelen < sizeof(sockaddr_in)) return false;
  sockaddr_in to;
  std::memcpy(&to, message.msg_name, sizeof(to));
  return to.sin_family == AF_INET && to.sin_port == withheld.sin_port &&
         to.sin_addr.s_addr == withheld.sin_addr.s_addr;
}

ssize_t BytesOf(const msghdr& message) {
  ssize_t bytes = 0;
  for (size_t i = 0; i < message.msg_iovlen; ++i) {
    bytes += static_cast<ssize_t>(message.msg_iov[i].iov_len);
  }
  return bytes;
}

}  // namespace

absl::Status Withhold(absl::string_view place) {
  const std::pair<std::string, std::string> parts = absl::StrSplit(place, absl::MaxSplits(':', 1));
  uint32_t port = 0;
  sockaddr_in to = {};
  to.sin_family = AF_INET;
  if (inet_pton(AF_INET, parts.first.c_str(), &to.sin_addr) != 1 ||
      !absl::SimpleAtoi(parts.second, &port) || port < 1 || port > 65'535) {
    return absl::InvalidArgumentError(absl::StrCat("--withhold wants ADDRESS:PORT, not ", place));
  }
  to.sin_port = htons(static_cast<uint16_t>(port));
  withheld = to;
  return absl::OkStatus();
}

}  // namespace rips::dds_peer

// In place of the C library's: the middleware sends with nothing else.
extern "C" ssize_t sendmsg(int fd, const msghdr* message, int flags) {
  using Send = ssize_t (*)(int, const msghdr*, int);
  static const auto send = reinterpret_cast<Send>(dlsym(RTLD_NEXT, "sendmsg"));
  if (rips::dds_peer::IsWithheld(*message)) return rips::dds_peer::BytesOf(*message);
  return send(fd, message, flags);
}
