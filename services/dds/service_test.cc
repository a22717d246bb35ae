#include <atomic>
#include <cmath>
#include <set>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/dds/service_client.h"
#include "services/ros2/ros_name.h"
#include "services/ros2/service_header.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "tests/support/ros2/forged_heartbeat.h"
#include "tests/support/ros2/server_messages.h"
#include "tests/support/ros2/service_server.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

const ServiceOptions kService = {.service = "/safety/change_mode", .type = ros2::kChangeModeType};
constexpr absl::Duration kLong = absl::Seconds(20);
constexpr absl::Duration kShort = absl::Milliseconds(200);

class ServiceTest : public TestWorld {
 protected:
  std::unique_ptr<ServiceClient> Client() {
    auto client = ServiceClient::Create(near(), kService);
    EXPECT_THAT(client, IsOk());
    return *std::move(client);
  }
  std::unique_ptr<ServiceServer> Server(ServiceHandler handler) {
    return ServerIn(far(), std::move(handler));
  }
  static std::unique_ptr<ServiceServer> ServerIn(Participant& in, ServiceHandler handler) {
    auto server = ServiceServer::Create(in, kService, std::move(handler));
    EXPECT_THAT(server, IsOk());
    return *std::move(server);
  }
};

// Echoes the mode, so that every reply tells which request it answers.
std::optional<std::string> Echo(absl::string_view request) {
  const auto mode = ros2::DecodeChangeModeRequest(request);
  return mode.ok() ? std::optional(ros2::EncodeGetModeReply(*mode)) : std::nullopt;
}

absl::StatusOr<std::string> CallEcho(ServiceClient& client, const std::string& mode,
                                     absl::Duration timeout) {
  const auto reply = client.Call(ros2::EncodeChangeModeRequest(mode), timeout);
  if (!reply.ok()) return reply.status();
  return ros2::DecodeGetModeReply(*reply);
}

TEST_F(ServiceTest, RoundTrips) {
  const auto server = Server(Echo);
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  EXPECT_TRUE(client->ServerReady());
  for (int i = 0; i < 100; ++i) {
    const std::string mode = absl::StrCat("MODE_", i);
    const auto reply = CallEcho(*client, mode, kLong);
    ASSERT_THAT(reply, IsOk());
    EXPECT_EQ(*reply, mode);
  }
}

TEST_F(ServiceTest, TheFirstCallNeedsNoWaiting) {
  const auto server = Server(Echo);
  const auto client = Client();
  EXPECT_EQ(*CallEcho(*client, "ALERT", kLong), "ALERT");
}

TEST_F(ServiceTest, NoServer) {
  const auto client = Client();
  EXPECT_FALSE(client->ServerReady());
  EXPECT_THAT(
      CallEcho(*client, "ALERT", kShort),
      StatusIs(absl::StatusCode::kDeadlineExceeded, "no server for `/safety/change_mode` in time"));
  EXPECT_THAT(client->WaitForServer(absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kDeadlineExceeded));
}

TEST_F(ServiceTest, ASilentServerThenAnAnswer) {
  std::atomic<int> calls = 0;
  const auto server = Server(
      [&](absl::string_view request) { return ++calls == 1 ? std::nullopt : Echo(request); });
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  EXPECT_THAT(
      CallEcho(*client, "FIRST", kShort),
      StatusIs(absl::StatusCode::kDeadlineExceeded, "no reply from `/safety/change_mode` in time"));
  EXPECT_EQ(*CallEcho(*client, "SECOND", kLong), "SECOND");
}

TEST_F(ServiceTest, ALateReplyDoesNotAnswerTheNextCall) {
  Mutex mu;
  CondVar changed;
  bool first_gave_up = false;
  const auto server = Server([&](absl::string_view request) {
    MutexLock lock(&mu);
    while (!first_gave_up) changed.Wait(lock);
    return Echo(request);
  });
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  EXPECT_THAT(CallEcho(*client, "FIRST", kShort), StatusIs(absl::StatusCode::kDeadlineExceeded));
  {
    MutexLock lock(&mu);
    first_gave_up = true;
    changed.NotifyAll();
  }
  EXPECT_EQ(*CallEcho(*client, "SECOND", kLong), "SECOND");
}

TEST_F(ServiceTest, CallsOfManyThreads) {
  const auto server = Server(Echo);
  const auto client = Client();
  std::vector<std::thread> threads;
  std::atomic<int> right = 0;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 25; ++i) {
        const std::string mode = absl::StrCat("M", t, "_", i);
        const auto reply = CallEcho(*client, mode, kLong);
        if (reply.ok() && *reply == mode) ++right;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(right, 100);
}

TEST_F(ServiceTest, ServerGoneAndBack) {
  auto server = Server(Echo);
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  server.reset();
  ASSERT_TRUE(Eventually([&] { return !client->ServerReady(); }));
  EXPECT_THAT(CallEcho(*client, "X", kShort), StatusIs(absl::StatusCode::kDeadlineExceeded));
  server = Server(Echo);
  EXPECT_EQ(*CallEcho(*client, "Y", kLong), "Y");
}

// A server made by hand: gives each request to `answer`, which says what goes out. Without ids in
// the user data it stands for one of another make.
class HandMadeServer {
 public:
  using Answer = std::function<std::vector<std::string>(const ros2::ServiceMessage&)>;
  HandMadeServer(Participant& in, Answer answer, const std::string& reader_id = "",
                 const std::string& writer_id = "") {
    writer_ = *RawWriter::Create(in, {.topic = ros2::MangleServiceReply(kService.service),
                                      .type = ros2::MangleServiceReplyType(kService.type),
                                      .user_data = writer_id});
    reader_ = *RawReader::Create(in,
                                 {.topic = ros2::MangleServiceRequest(kService.service),
                                  .type = ros2::MangleServiceRequestType(kService.type),
                                  .reliable = true,
                                  .user_data = reader_id},
                                 [this, answer](const RawSample& sample) {
                                   const auto request = ros2::SplitServiceHeader(sample.payload);
                                   if (!request.ok()) return;
                                   for (const std::string& reply : answer(*request)) {
                                     writer_->Write(reply).IgnoreError();
                                   }
                                 });
  }
  const RawWriter& writer() const { return *writer_; }
  const RawReader& reader() const { return *reader_; }

 private:
  std::unique_ptr<RawWriter> writer_;
  std::unique_ptr<RawReader> reader_;
};

std::string Reply(const ros2::ServiceHeader& header, const std::string& mode) {
  return *ros2::AddServiceHeader(ros2::EncodeGetModeReply(mode), header);
}

TEST_F(ServiceTest, OnlyTheReplyToThisCallCounts) {
  std::atomic<bool> right_one_too = false;
  const HandMadeServer server(far(), [&](const ros2::ServiceMessage& request) {
    ros2::ServiceHeader other_client = request.header;
    ++other_client.client_id;
    ros2::ServiceHeader other_call = request.header;
    ++other_call.sequence;
    std::vector<std::string> replies = {Reply(other_client, "WRONG"),
                                        Reply(other_call, "WRONG"),
                                        Reply({}, "WRONG"),
                                        std::string("\0\1\0\0", 4),
                                        std::string("\0\1\0\0\xff\xff\xff\xff", 8),
                                        Reply(request.header, "x").substr(0, 16)};
    if (right_one_too) replies.push_back(Reply(request.header, "RIGHT"));
    return replies;
  });
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  EXPECT_THAT(CallEcho(*client, "X", kShort),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("no reply")));
  right_one_too = true;
  EXPECT_EQ(*CallEcho(*client, "X", kLong), "RIGHT");
}

TEST_F(ServiceTest, HalvesOfTwoServersAreNoServer) {
  const auto none = [](const ros2::ServiceMessage&) { return std::vector<std::string>(); };
  const HandMadeServer server(far(), none, "serviceid= 1.2;", "serviceid= 1.3;");
  const auto client = Client();
  ASSERT_TRUE(Eventually([&] {
    return server.writer().MatchedReaders() == 1 && !server.reader().MatchedWriters().empty();
  }));
  // Discovery is complete on the server's side; give the client's side the same chance.
  EXPECT_THAT(client->WaitForServer(kShort), StatusIs(absl::StatusCode::kDeadlineExceeded));
  const HandMadeServer whole(far(), none, "serviceid= 7.7;", "serviceid= 7.7;");
  EXPECT_THAT(client->WaitForServer(kLong), IsOk());
}

TEST_F(ServiceTest, OnlyTheServerThatWasAskedCanReply) {
  // A writer of replies without a reader of requests, which is no server; it knows the request and
  // is quicker than the server.
  const auto forger =
      *RawWriter::Create(third(), {.topic = ros2::MangleServiceReply(kService.service),
                                   .type = ros2::MangleServiceReplyType(kService.type),
                                   .user_data = "serviceid= 7.7;"});
  std::atomic<bool> server_answers = false;
  const HandMadeServer server(
      far(),
      [&](const ros2::ServiceMessage& request) {
        EXPECT_THAT(forger->Write(Reply(request.header, "FORGED")), IsOk());
        return server_answers ? std::vector<std::string>{Reply(request.header, "TRUE")}
                              : std::vector<std::string>();
      },
      "serviceid= 7.7;", "serviceid= 7.7;");
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  ASSERT_TRUE(Eventually([&] { return forger->MatchedReaders() == 1; }));
  EXPECT_EQ(client->Server(), server.reader().guid());
  EXPECT_THAT(CallEcho(*client, "X", kShort),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("no reply")));
  server_answers = true;
  EXPECT_EQ(*CallEcho(*client, "X", kLong), "TRUE");
}

TEST_F(ServiceTest, OfSeveralServersNoneIsBelieved) {
  std::atomic<bool> asked_first = false;
  std::atomic<bool> asked_second = false;
  const auto server = Server([&](absl::string_view request) {
    asked_first = true;
    return Echo(request);
  });
  auto second = ServerIn(third(), [&](absl::string_view request) {
    asked_second = true;
    return Echo(request);
  });
  const auto client = Client();
  const auto several = [&] {
    return absl::IsFailedPrecondition(CallEcho(*client, "X", kLong).status());
  };
  ASSERT_TRUE(Eventually(several));
  EXPECT_TRUE(client->ServerReady());
  EXPECT_EQ(client->Server(), std::nullopt);
  asked_first = asked_second = false;
  EXPECT_THAT(
      CallEcho(*client, "X", kLong),
      StatusIs(absl::StatusCode::kFailedPrecondition,
               AllOf(HasSubstr("2 servers offer `/safety/change_mode`, of participants "),
                     HasSubstr(ToString(far().guid())), HasSubstr(ToString(third().guid())))));
  EXPECT_FALSE(asked_first || asked_second);
  // An order goes to both, also when they hear nothing more of the client's first writer.
  for (const ros2::Guid& victim : {far().guid(), third().guid()}) {
    ASSERT_THAT(SendToDomain(RandomDomain(), ForgedHeartbeat(client->request_writer(), victim)),
                IsOk());
  }
  const auto order = [&] {
    EXPECT_THAT(client->Call(ros2::EncodeChangeModeRequest("X"), kLong, IfSeveral::kSendToAll),
                StatusIs(absl::StatusCode::kFailedPrecondition));
    return asked_first && asked_second;
  };
  EXPECT_TRUE(Eventually(order));

  second.reset();
  EXPECT_TRUE(Eventually([&] { return CallEcho(*client, "X", kLong).ok(); }));
}

TEST_F(ServiceTest, AServiceIdThatWasCopiedMakesNoServerOfTwoHalves) {
  const auto none = [](const ros2::ServiceMessage&) { return std::vector<std::string>(); };
  const HandMadeServer far_server(far(), none, "serviceid= 7.7;", "serviceid= 1.1;");
  const HandMadeServer rival_server(third(), none, "serviceid= 2.2;", "serviceid= 7.7;");
  const auto client = Client();
  ASSERT_TRUE(Eventually([&] {
    return far_server.writer().MatchedReaders() == 1 && rival_server.writer().MatchedReaders() == 1;
  }));
  EXPECT_THAT(client->WaitForServer(kShort), StatusIs(absl::StatusCode::kDeadlineExceeded));
  const HandMadeServer whole(third(), none, "serviceid= 9.9;", "serviceid= 9.9;");
  EXPECT_TRUE(Eventually([&] { return client->Server() == whole.reader().guid(); }));
}

TEST_F(ServiceTest, AmongTooManyEndpointsNoServerIsBelieved) {
  const auto server = Server(Echo);
  const auto client = Client();
  ASSERT_EQ(*CallEcho(*client, "X", kLong), "X");
  // Of the client's own participant: they are matched at once.
  std::vector<std::unique_ptr<RawReader>> readers;
  for (int i = 0; i < 256; ++i) {
    readers.push_back(*RawReader::Create(near(),
                                         {.topic = ros2::MangleServiceRequest(kService.service),
                                          .type = ros2::MangleServiceRequestType(kService.type),
                                          .ignore_own = false},
                                         [](const RawSample&) {}));
  }
  EXPECT_THAT(CallEcho(*client, "X", kLong), StatusIs(absl::StatusCode::kFailedPrecondition,
                                                      HasSubstr("too many endpoints offer")));
  readers.pop_back();
  EXPECT_TRUE(Eventually([&] { return CallEcho(*client, "X", kLong).ok(); }));
}

TEST_F(ServiceTest, AServerThatWasMadeDeafHearsTheNextCall) {
  const auto server = Server(Echo);
  const auto client = Client();
  ASSERT_EQ(*CallEcho(*client, "BEFORE", kLong), "BEFORE");
  ASSERT_THAT(SendToDomain(RandomDomain(), ForgedHeartbeat(client->request_writer(), far().guid())),
              IsOk());
  // The datagram and the next request race; one of the calls finds the server deaf.
  ASSERT_TRUE(Eventually([&] { return !CallEcho(*client, "LOST", kShort).ok(); }));
  EXPECT_EQ(*CallEcho(*client, "AFTER", kLong), "AFTER");
}

TEST_F(ServiceTest, ASilentServerCostsFewNewEndpoints) {
  const auto server = Server([](absl::string_view) { return std::nullopt; });
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  const RealClock clock;
  const int64_t start_ns = clock.Now().boottime_ns;
  std::set<ros2::Guid> writers;
  for (int i = 0; i < 20; ++i) {
    EXPECT_FALSE(CallEcho(*client, "X", absl::Milliseconds(10)).ok());
    writers.insert(client->request_writer());
  }
  const double seconds = static_cast<double>(clock.Now().boottime_ns - start_ns) / 1e9;
  EXPECT_GE(writers.size(), 2u);
  // The second at once, then after pauses of 1, 2, 4 ... s.
  EXPECT_LE(writers.size(), 2 + std::floor(std::log2(1 + seconds)));
}

TEST_F(ServiceTest, AReplyThatIsTooLongIsIgnored) {
  std::atomic<size_t> bytes = 2U << 20;
  const HandMadeServer server(far(), [&](const ros2::ServiceMessage& request) {
    return std::vector<std::string>{Reply(request.header, std::string(bytes, 'x'))};
  });
  const auto client = Client();
  ASSERT_THAT(client->WaitForServer(kLong), IsOk());
  EXPECT_THAT(CallEcho(*client, "X", absl::Seconds(1)),
              StatusIs(absl::StatusCode::kDeadlineExceeded));
  bytes = 3;
  EXPECT_EQ(*CallEcho(*client, "X", kLong), "xxx");
}

TEST_F(ServiceTest, RequestsBeyondTheQueueAreDropped) {
  Mutex mu;
  CondVar changed;
  bool open = false;
  std::atomic<size_t> handled = 0;
  auto server = *ServiceServer::Create(near(), kService,
                                       [&](absl::string_view) -> std::optional<std::string> {
                                         ++handled;
                                         MutexLock lock(&mu);
                                         while (!open) changed.Wait(lock);
                                         return std::nullopt;
                                       });
  // Of the same participant: a sample is delivered before Write returns.
  const auto writer =
      *RawWriter::Create(near(), {.topic = ros2::MangleServiceRequest(kService.service),
                                  .type = ros2::MangleServiceRequestType(kService.type)});
  ASSERT_TRUE(Eventually([&] { return writer->MatchedReaders() == 1; }));
  const std::string request =
      *ros2::AddServiceHeader(ros2::EncodeChangeModeRequest("X"), {.client_id = 1});
  ASSERT_THAT(writer->Write(request), IsOk());
  ASSERT_TRUE(Eventually([&] { return handled == 1; }));
  // The handler holds one; the queue takes its fill and the rest is lost.
  for (size_t i = 0; i < 3 * kServiceQueueMax; ++i) ASSERT_THAT(writer->Write(request), IsOk());
  {
    MutexLock lock(&mu);
    open = true;
    changed.NotifyAll();
  }
  server.reset();  // after what is queued
  EXPECT_EQ(handled, 1 + kServiceQueueMax);
}

TEST_F(ServiceTest, BadNames) {
  for (const ServiceOptions& bad :
       {ServiceOptions{.service = "safety", .type = ros2::kChangeModeType},
        ServiceOptions{.service = "/a b", .type = ros2::kChangeModeType},
        ServiceOptions{.service = "/safety", .type = "system modes"},
        ServiceOptions{.service = "/safety", .type = ""}}) {
    EXPECT_THAT(ServiceClient::Create(near(), bad), StatusIs(absl::StatusCode::kInvalidArgument));
    EXPECT_THAT(ServiceServer::Create(near(), bad, Echo),
                StatusIs(absl::StatusCode::kInvalidArgument));
  }
  const auto server = Server(Echo);
  const auto client = Client();
  EXPECT_THAT(client->Call("x", kLong), StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::dds
