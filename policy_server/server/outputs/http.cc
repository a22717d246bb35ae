#include "policy_server/server/outputs/http.h"

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::outputs {
namespace {

constexpr absl::string_view kHeadEnd = "\r\n\r\n";
constexpr int kNoContent = 204;

}  // namespace

std::string FormatPost(absl::string_view host, int port, absl::string_view path,
                       const HttpHeaders& headers, absl::string_view body) {
  const bool ipv6 = absl::StrContains(host, ':');
  std::string request =
      absl::StrCat("POST ", path, " HTTP/1.1\r\nHost: ", ipv6 ? "[" : "", host, ipv6 ? "]" : "",
                   ":", port, "\r\nUser-Agent: rips\r\nContent-Type: application/json\r\n",
                   "Content-Length: ", body.size(), "\r\nConnection: close\r\n");
  for (const auto& [name, value] : headers) absl::StrAppend(&request, name, ": ", value, "\r\n");
  absl::StrAppend(&request, "\r\n", body);
  return request;
}

absl::Status HttpAnswer::Feed(absl::string_view bytes) {
  while (status_ == 0 && !bytes.empty()) {
    // One byte more than fits shows that it does not.
    const size_t taken = std::min(bytes.size(), kHeadBytesMax + 1 - head_.size());
    const size_t before = head_.size();
    absl::StrAppend(&head_, bytes.substr(0, taken));
    const size_t from = before < kHeadEnd.size() ? 0 : before - kHeadEnd.size();
    const size_t end = absl::string_view(head_).find(kHeadEnd, from);
    if (end == std::string::npos) {
      if (head_.size() > kHeadBytesMax) return absl::DataLossError("the answer's head is too long");
      return absl::OkStatus();
    }
    bytes.remove_prefix(end + kHeadEnd.size() - before);
    RIPS_RETURN_IF_ERROR(ParseHead(absl::string_view(head_).substr(0, end)));
    head_.clear();
  }
  absl::StrAppend(&body_, bytes.substr(0, kBodyBytesMax - body_.size()));
  return absl::OkStatus();
}

absl::Status HttpAnswer::ParseHead(absl::string_view head) {
  const absl::string_view line = head.substr(0, head.find("\r\n"));
  int status = 0;
  // `HTTP/1.1 200`, and a space and words, or nothing.
  constexpr size_t kStatusAt = 9;
  constexpr size_t kStatusEnd = 12;
  const bool whole = line.size() >= kStatusEnd && absl::StartsWith(line, "HTTP/1.") &&
                     line[kStatusAt - 1] == ' ' &&
                     (line.size() == kStatusEnd || line[kStatusEnd] == ' ') &&
                     std::all_of(line.begin() + kStatusAt, line.begin() + kStatusEnd,
                                 [](unsigned char c) { return absl::ascii_isdigit(c); }) &&
                     absl::SimpleAtoi(line.substr(kStatusAt, 3), &status) && status >= 100;
  if (!whole) return absl::DataLossError("the answer is not HTTP/1");
  if (status < 200) {
    if (status == 101) return absl::DataLossError("the answer wants another protocol");
    if (++interim_ > kInterimMax) return absl::DataLossError("too many interim answers");
    return absl::OkStatus();
  }
  status_ = status;
  if (status == kNoContent) body_bytes_ = 0;
  for (size_t at = line.size(); at < head.size();) {
    const size_t next = std::min(head.find("\r\n", at + 2), head.size());
    ParseHeader(head.substr(at + 2, next - at - 2));
    at = next;
  }
  return absl::OkStatus();
}

void HttpAnswer::ParseHeader(absl::string_view line) {
  const size_t colon = line.find(':');
  if (colon == absl::string_view::npos) return;
  const absl::string_view name = line.substr(0, colon);
  const absl::string_view value = absl::StripAsciiWhitespace(line.substr(colon + 1));
  uint64_t length = 0;
  if (absl::EqualsIgnoreCase(name, "content-length") && absl::SimpleAtoi(value, &length)) {
    body_bytes_ = static_cast<size_t>(std::min<uint64_t>(length, body_bytes_));
  }
  if (absl::EqualsIgnoreCase(name, "transfer-encoding")) chunked_ = true;
}

bool HttpAnswer::done() const {
  if (status_ == 0) return false;
  if (chunked_) {
    return body_.size() >= kBodyBytesMax || absl::EndsWith(body_, "\r\n0\r\n\r\n") ||
           body_ == "0\r\n\r\n";
  }
  return body_.size() >= body_bytes_;
}

}  // namespace rips::outputs
