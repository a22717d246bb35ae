#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/outputs/fake_peer_for_test.h"
#include "policy_server/server/outputs/syslog_receiver.h"
#include "policy_server/server/outputs/webhook_receiver.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/rpc/test_pki.h"

namespace rips::outputs {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

constexpr char kOk[] = "HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
// Those of a test that waits for one of them.
constexpr Timeouts kShort = {.connect = absl::Milliseconds(100),
                             .send = absl::Milliseconds(100),
                             .answer = absl::Milliseconds(100),
                             .settle = absl::Milliseconds(20)};

std::vector<store::AlertRecord> Alerts(int count) {
  std::vector<store::AlertRecord> alerts;
  for (int i = 0; i < count; ++i) alerts.push_back(store::MakeAlert("r1", absl::StrCat(i)));
  return alerts;
}

// ------------------------------------------------------------------------------------- webhook

class WebhookTest : public ::testing::Test {
 protected:
  std::unique_ptr<WebhookReceiver> Receiver(int port, const Timeouts& timeouts = {}) {
    config_.kind = server::OutputConfig::Kind::kWebhook;
    config_.endpoint.host = "127.0.0.1";
    config_.endpoint.port = port;
    config_.endpoint.tls = !config_.endpoint.ca.empty();
    config_.path = "/rips";
    return std::make_unique<WebhookReceiver>(config_, timeouts, &clock_);
  }
  absl::Status SendTo(const FakePeer::Serve& serve, const Timeouts& timeouts = {}) {
    FakePeer peer(serve);
    return Receiver(peer.port(), timeouts)->Send(Alerts(1));
  }
  // As what an answer is judged.
  absl::Status Answered(const std::string& answer) {
    return SendTo([&](Taken& taken) {
      taken.ReadRequest();
      taken.Write(answer);
    });
  }

  store::TempDir dir_;
  FakeClock clock_;
  server::OutputConfig config_;
};

TEST_F(WebhookTest, PostsASignedArrayOverTls) {
  rpc::TestPki pki;
  const TlsFiles files = pki.Mint({.folder = "hook", .san = "IP:127.0.0.1", .by_root = true});
  config_.endpoint.ca = files.ca;
  config_.secret_file = dir_.File("secret");
  std::ofstream(config_.secret_file) << "hunter2\n";
  std::string request;
  const std::vector<store::AlertRecord> alerts = Alerts(3);
  {
    FakePeer peer(
        [&](Taken& taken) {
          request = taken.ReadRequest();
          taken.Write(kOk);
        },
        &files);
    EXPECT_THAT(Receiver(peer.port())->Send(alerts), IsOk());
  }
  const size_t head = request.find("\r\n\r\n");
  ASSERT_NE(head, std::string::npos);
  const std::string body = request.substr(head + 4);
  EXPECT_THAT(
      request,
      AllOf(StartsWith("POST /rips HTTP/1.1\r\n"), HasSubstr("X-Rips-Timestamp: 1767225600\r\n"),
            HasSubstr(absl::StrCat("X-Rips-Signature: ", SignBody("hunter2", "1767225600", body),
                                   "\r\n")),
            Not(HasSubstr("hunter2"))));
  const auto json = nlohmann::json::parse(body);
  ASSERT_EQ(json.size(), 3u);
  EXPECT_EQ(json[2]["id"], alerts[2].id);
}

TEST(SignatureTest, IsHmacSha256) {
  // printf '1.[]' | openssl dgst -sha256 -hmac key
  EXPECT_EQ(SignBody("key", "1", "[]"),
            "sha256=74844a5a51cfee4367dd6f6d7903d46a076eb27921483686e5a7cac98f726d1c");
}

TEST_F(WebhookTest, SendsOcsfIfToldSo) {
  config_.format = server::OutputConfig::Format::kOcsf;
  std::string request;
  EXPECT_THAT(SendTo([&](Taken& taken) {
                request = taken.ReadRequest();
                taken.Write(kOk);
              }),
              IsOk());
  EXPECT_THAT(request, HasSubstr("\r\n\r\n[{\"category_uid\":2,"));
}

TEST_F(WebhookTest, AnswersAreJudged) {
  EXPECT_THAT(Answered(kOk), IsOk());
  EXPECT_THAT(Answered("HTTP/1.1 204 None\r\n\r\n"), IsOk());
  for (const int status : {400, 413, 415, 422}) {
    EXPECT_THAT(Answered(absl::StrCat("HTTP/1.1 ", status, " No\r\n\r\nbad \x1b]0;field")),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr(absl::StrCat(status)), Not(HasSubstr("\x1b")))));
  }
  for (const int status : {301, 302, 307, 308, 401, 403, 404, 408, 410, 429, 499, 500, 503, 600}) {
    EXPECT_THAT(Answered(absl::StrCat("HTTP/1.1 ", status,
                                      " Later\r\nLocation: http://127.0.0.1:1/\r\n\r\n")),
                StatusIs(absl::StatusCode::kUnavailable, HasSubstr(absl::StrCat(status))));
  }
  EXPECT_THAT(Answered("SSH-2.0-x\r\n\r\n"), StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(Answered("HTTP/1.1 200 O"), StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(Answered(""), StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(WebhookTest, AnswersWithoutEndAreCutOff) {
  for (const std::string begin : {"HTTP/1.1 200 ", "HTTP/1.1 200 OK\r\nA: "}) {
    EXPECT_THAT(SendTo([&](Taken& taken) {
                  taken.ReadRequest();
                  taken.Write(begin);
                  while (taken.Write(std::string(size_t{64} << 10, 'A'))) {
                  }
                }),
                StatusIs(absl::StatusCode::kDataLoss));
  }
  // The head decides.
  EXPECT_THAT(SendTo([&](Taken& taken) {
                taken.ReadRequest();
                taken.Write("HTTP/1.1 200 OK\r\n\r\n");
                while (taken.Write(std::string(size_t{64} << 10, 'A'))) {
                }
              }),
              IsOk());
}

TEST_F(WebhookTest, AReceiverThatHangsHasATime) {
  EXPECT_THAT(SendTo([](Taken& taken) { taken.Hang(); }, kShort),
              StatusIs(absl::StatusCode::kDeadlineExceeded));
}

TEST_F(WebhookTest, AnAnswerBeforeTheEndOfTheRequestCounts) {
  FakePeer peer([](Taken& taken) {
    taken.Read();
    taken.Write("HTTP/1.1 413 Too large\r\nContent-Length: 0\r\n\r\n");
    taken.Hang();
  });
  std::vector<store::AlertRecord> alerts = Alerts(100);
  for (store::AlertRecord& alert : alerts) alert.text = std::string(size_t{16} << 10, '\x01');
  EXPECT_THAT(Receiver(peer.port())->Send(alerts),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("413")));
}

TEST_F(WebhookTest, SecretsAreReadAnewAndNeverShown) {
  config_.secret_file = dir_.File("secret");
  std::string request;
  FakePeer peer([&](Taken& taken) {
    request = taken.ReadRequest();
    taken.Write(kOk);
  });
  const auto receiver = Receiver(peer.port());
  EXPECT_THAT(receiver->Send(Alerts(1)),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr(config_.secret_file)));
  std::ofstream(config_.secret_file) << "\n";
  EXPECT_THAT(receiver->Send(Alerts(1)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("is empty")));
  std::ofstream(config_.secret_file) << "good";
  EXPECT_THAT(receiver->Send(Alerts(1)), IsOk());
  std::ofstream(config_.secret_file) << std::string(5'000, 's');
  const absl::Status status = receiver->Send(Alerts(1));
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(std::string(status.message()), Not(HasSubstr("sss")));
}

TEST_F(WebhookTest, CancelEndsASend) {
  FakePeer peer([](Taken& taken) { taken.Hang(); });
  const auto receiver = Receiver(peer.port());
  std::thread canceller([&] { receiver->Cancel(); });
  EXPECT_THAT(receiver->Send(Alerts(1)), StatusIs(absl::StatusCode::kCancelled));
  canceller.join();
}

// -------------------------------------------------------------------------------------- syslog

class SyslogTest : public ::testing::Test {
 protected:
  std::unique_ptr<SyslogReceiver> Receiver(int port, const Timeouts& timeouts = {
                                                         .settle = absl::Milliseconds(20)}) {
    config_.endpoint.host = "127.0.0.1";
    config_.endpoint.port = port;
    config_.endpoint.tls = !config_.endpoint.ca.empty();
    return std::make_unique<SyslogReceiver>(config_, timeouts);
  }
  server::OutputConfig config_;
};

// The messages of whole frames.
std::vector<std::string> Unframe(absl::string_view bytes) {
  std::vector<std::string> messages;
  while (!bytes.empty()) {
    const size_t space = bytes.find(' ');
    size_t length = 0;
    if (space == absl::string_view::npos || !absl::SimpleAtoi(bytes.substr(0, space), &length) ||
        bytes.size() < space + 1 + length) {
      break;
    }
    messages.emplace_back(bytes.substr(space + 1, length));
    bytes.remove_prefix(space + 1 + length);
  }
  return messages;
}

TEST_F(SyslogTest, SendsFramesOverOneTlsConnection) {
  rpc::TestPki pki;
  const TlsFiles files = pki.Mint({.folder = "siem", .san = "IP:127.0.0.1", .by_root = true});
  config_.endpoint.ca = files.ca;
  config_.format = server::OutputConfig::Format::kText;
  std::string all;
  int connections = 0;
  {
    FakePeer peer(
        [&](Taken& taken) {
          ++connections;
          all += taken.ReadUntil([](const std::string&) { return false; });
        },
        &files);
    const auto receiver = Receiver(peer.port());
    EXPECT_THAT(receiver->Send(Alerts(2)), IsOk());
    EXPECT_THAT(receiver->Send(Alerts(1)), IsOk());
  }
  const std::vector<std::string> messages = Unframe(all);
  ASSERT_EQ(messages.size(), 3u);
  EXPECT_THAT(messages[1], AllOf(StartsWith("<83>1 2026-01-01T00:00:00.000000Z "),
                                 HasSubstr(" rips - intruder [rips@32473 "),
                                 HasSubstr("r1: high: 1 (graph change)")));
  EXPECT_EQ(connections, 1);
}

TEST_F(SyslogTest, AlertsOfAConnectionThatBreaksAreNotAccepted) {
  FakePeer peer([](Taken& taken) {
    taken.Read();
    taken.Reset();
  });
  EXPECT_THAT(Receiver(peer.port(), Timeouts())->Send(Alerts(1)),
              StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(SyslogTest, ConnectsAnewAfterTheReceiverHasClosed) {
  int connections = 0;
  std::string all;
  {
    FakePeer peer([&](Taken& taken) {
      if (++connections == 1) {
        all += taken.Read();
        return;
      }
      all += taken.ReadUntil([](const std::string&) { return false; });
    });
    const auto receiver = Receiver(peer.port(), Timeouts());
    EXPECT_THAT(receiver->Send(Alerts(1)), StatusIs(absl::StatusCode::kUnavailable));
    EXPECT_THAT(receiver->Send(Alerts(1)), IsOk());
  }
  EXPECT_EQ(connections, 2);
  EXPECT_EQ(Unframe(all).size(), 2u);
}

}  // namespace
}  // namespace rips::outputs
