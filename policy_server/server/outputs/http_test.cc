#include "policy_server/server/outputs/http.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"

namespace rips::outputs {
namespace {

using ::testing::HasSubstr;

TEST(HttpTest, WritesOnePost) {
  EXPECT_EQ(FormatPost("h", 443, "/p?q", {{"X-A", "b"}}, "[1]"),
            "POST /p?q HTTP/1.1\r\nHost: h:443\r\nUser-Agent: rips\r\n"
            "Content-Type: application/json\r\nContent-Length: 3\r\nConnection: close\r\n"
            "X-A: b\r\n\r\n[1]");
  EXPECT_THAT(FormatPost("::1", 80, "/", {}, ""), HasSubstr("Host: [::1]:80\r\n"));
}

// The same byte by byte and at once.
void ExpectStatus(const std::string& text, int status, const std::string& body, bool done) {
  for (const size_t piece : {size_t{1}, size_t{3}, text.size()}) {
    HttpAnswer answer;
    for (size_t at = 0; at < text.size(); at += piece) {
      ASSERT_THAT(answer.Feed(absl::string_view(text).substr(at, piece)), IsOk()) << text;
    }
    EXPECT_EQ(answer.status(), status) << text;
    EXPECT_EQ(answer.body(), body) << text;
    EXPECT_EQ(answer.done(), done) << text;
  }
}

TEST(HttpTest, ReadsAnswers) {
  ExpectStatus("HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok", 200, "ok", true);
  ExpectStatus("HTTP/1.1 200\r\ncontent-length:  0 \r\n\r\n", 200, "", true);
  ExpectStatus("HTTP/1.0 503 Away\r\n\r\nlater", 503, "later", false);
  ExpectStatus("HTTP/1.1 204 None\r\n\r\n", 204, "", true);
  ExpectStatus("HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 202 Ok\r\nContent-Length: 0\r\n\r\n", 202, "",
               true);
  ExpectStatus("HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nok\r\n0\r\n\r\n", 200,
               "2\r\nok\r\n0\r\n\r\n", true);
  ExpectStatus("HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nok\r\n", 200,
               "2\r\nok\r\n", false);
  ExpectStatus("HTTP/1.1 200 OK\r\nContent-Length: 18446744073709551616\r\n\r\nx", 200, "x", false);
  ExpectStatus("HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\nx", 200, "x", false);
  ExpectStatus("HTTP/1.1 200 O", 0, "", false);
}

TEST(HttpTest, RefusesWhatIsNotHttp) {
  for (const char* text :
       {"\r\n\r\n", "SSH-2.0-OpenSSH\r\n\r\n", "HTTP/2 200\r\n\r\n", "HTTP/1.1 20x OK\r\n\r\n",
        "HTTP/1.1 +20 OK\r\n\r\n", "HTTP/1.1 2000 OK\r\n\r\n", "HTTP/1.1 099 OK\r\n\r\n",
        "HTTP/1.1  200 OK\r\n\r\n", "HTTP/1.1 101 Switching\r\n\r\n"}) {
    HttpAnswer answer;
    EXPECT_THAT(answer.Feed(text), StatusIs(absl::StatusCode::kDataLoss)) << text;
    EXPECT_EQ(answer.status(), 0);
  }
}

TEST(HttpTest, ABodyIsKeptUpToItsLimit) {
  HttpAnswer answer;
  ASSERT_THAT(answer.Feed("HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n"), IsOk());
  for (int i = 0; i < 100; ++i) ASSERT_THAT(answer.Feed(std::string(1'000, 'x')), IsOk());
  EXPECT_TRUE(answer.done());
  EXPECT_EQ(answer.body().size(), HttpAnswer::kBodyBytesMax);
}

TEST(HttpTest, HeadsWithoutEndAreRefused) {
  HttpAnswer line;
  EXPECT_THAT(line.Feed(absl::StrCat("HTTP/1.1 200 ", std::string(2 << 20, 'A'))),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("too long")));
  HttpAnswer headers;
  absl::Status status = headers.Feed("HTTP/1.1 200 OK\r\n");
  for (int i = 0; i < 10'000 && status.ok(); ++i) status = headers.Feed("A: b\r\n");
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kDataLoss, HasSubstr("too long")));
  HttpAnswer interim;
  status = absl::OkStatus();
  for (int i = 0; i < 100 && status.ok(); ++i) status = interim.Feed("HTTP/1.1 102 Wait\r\n\r\n");
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kDataLoss, HasSubstr("interim")));
}

}  // namespace
}  // namespace rips::outputs
