// The HTTP/1.1 that a webhook needs: one POST and its answer, of which nothing is believed. Pure.
//
// Limits of an answer: 16 KiB for each head, 8 interim heads (1xx), and 64 KiB of the body, whose
// rest is not read. What exceeds a head's limit is an error; nothing is decoded.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_HTTP_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_HTTP_H_

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips::outputs {

using HttpHeaders = std::vector<std::pair<std::string, std::string>>;

// `host` without brackets; `path` in printable ASCII. The server is asked to close the connection
// after its answer.
std::string FormatPost(absl::string_view host, int port, absl::string_view path,
                       const HttpHeaders& headers, absl::string_view body);

// One answer, as its bytes come. Not thread-safe.
class HttpAnswer {
 public:
  static constexpr size_t kHeadBytesMax = size_t{16} << 10;
  static constexpr size_t kBodyBytesMax = size_t{64} << 10;
  static constexpr int kInterimMax = 8;

  // DataLoss if this is not HTTP/1 or exceeds a limit.
  absl::Status Feed(absl::string_view bytes);

  // 0 before the head of the final answer is whole, then 200 to 999.
  int status() const { return status_; }
  // Nothing more needs to be read.
  bool done() const;
  // As received, without decoding.
  absl::string_view body() const { return body_; }

 private:
  absl::Status ParseHead(absl::string_view head);
  void ParseHeader(absl::string_view line);

  std::string head_;
  std::string body_;
  int interim_ = 0;
  int status_ = 0;
  bool chunked_ = false;
  // As the head says; kBodyBytesMax if it does not, or says more.
  size_t body_bytes_ = kBodyBytesMax;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_HTTP_H_
