#include "services/rpc/session_watch.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"
#include "services/runtime/bounded_queue.h"

namespace rips::rpc {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Pair;
using ::testing::SizeIs;

class SessionWatchTest : public ::testing::Test {
 protected:
  static constexpr int64_t kHelloNs = 5 * kNanosPerSecond;

  struct Watched {
    std::vector<grpc::Status> ends;
    std::shared_ptr<SessionWatch::Session> session;
  };
  void Add(Watched* watched, absl::Time not_after = absl::InfiniteFuture()) {
    watched->session =
        watch_.Add({.identity = {}, .not_after = not_after},
                   [watched](const grpc::Status& status) { watched->ends.push_back(status); });
  }
  absl::Time Wall() const { return absl::FromUnixNanos(clock_.Now().unix_ns); }

  FakeClock clock_;
  SessionWatch watch_{&clock_, absl::InfiniteDuration()};
};

TEST_F(SessionWatchTest, EndsAStreamWithoutHelloAfterFiveSeconds) {
  Watched silent;
  Add(&silent);

  clock_.Advance(kHelloNs);
  watch_.CheckSessions();
  EXPECT_THAT(silent.ends, IsEmpty());
  clock_.Advance(1);
  watch_.CheckSessions();

  ASSERT_THAT(silent.ends, SizeIs(1));
  EXPECT_EQ(silent.ends[0].error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_EQ(silent.ends[0].error_message(), "no hello within 5s");
}

TEST_F(SessionWatchTest, EndsAnAgentsStreamThatFallsSilent) {
  Watched agent;
  Watched watcher;
  Add(&agent);
  Add(&watcher);
  for (Watched* each : {&agent, &watcher}) each->session->greeted = true;
  watch_.Heard(*agent.session, 30);

  clock_.Advance(15 * kNanosPerSecond);
  watch_.CheckSessions();
  EXPECT_THAT(agent.ends, IsEmpty());
  watch_.Heard(*agent.session, 30);
  clock_.Advance(15 * kNanosPerSecond + 1);
  watch_.CheckSessions();

  ASSERT_THAT(agent.ends, SizeIs(1));
  EXPECT_EQ(agent.ends[0].error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_EQ(agent.ends[0].error_message(), "no heartbeat within 15s");
  EXPECT_THAT(watcher.ends, IsEmpty()) << "who only listens sends nothing";
}

TEST_F(SessionWatchTest, SessionsOfAnAgentThatIsDearToReadPauseTogether) {
  int resumed = 0;
  const auto add = [&](const char* robot) {
    return watch_.Add(
        {.identity = {.role = Role::kSensor, .robot = robot}, .not_after = Wall() + absl::Hours(1)},
        [](const grpc::Status&) { FAIL(); }, nullptr, nullptr, [&resumed] { ++resumed; });
  };
  const auto first = add("r1");
  const auto second = add("r1");
  const auto other = add("r2");
  using Next = ReadingPace::Next;
  EXPECT_EQ(watch_.OnRead(*first, 600 * kNanosPerMilli), Next::kPauseIsNews);
  EXPECT_EQ(watch_.OnRead(*second, 0), Next::kPause);
  EXPECT_EQ(watch_.OnRead(*other, 0), Next::kRead);
  EXPECT_FALSE(watch_.MayRead(*second));
  EXPECT_TRUE(watch_.MayRead(*other));
  watch_.CheckSessions();
  EXPECT_EQ(resumed, 1) << "that of r2, which does not mind";
  clock_.Advance(1'100 * kNanosPerMilli);
  watch_.CheckSessions();
  EXPECT_EQ(resumed, 4);
  Watched operator_stream;
  Add(&operator_stream);
  EXPECT_EQ(watch_.OnRead(*operator_stream.session, 600 * kNanosPerMilli), Next::kRead);
}

TEST_F(SessionWatchTest, EachStreamHasItsOwnFiveSeconds) {
  Watched early;
  Watched late;
  Add(&early);
  clock_.Advance(kHelloNs);
  Add(&late);

  clock_.Advance(1);
  watch_.CheckSessions();

  EXPECT_THAT(early.ends, SizeIs(1));
  EXPECT_THAT(late.ends, IsEmpty());
}

TEST_F(SessionWatchTest, AStreamThatSaidHelloStays) {
  Watched greeted;
  Add(&greeted);
  clock_.Advance(kHelloNs);
  greeted.session->greeted = true;

  clock_.Advance(3600 * kNanosPerSecond);
  watch_.CheckSessions();

  EXPECT_THAT(greeted.ends, IsEmpty());
}

TEST_F(SessionWatchTest, CountsOpenStreamsThatHaveSaidHelloByRole) {
  Watched ends;
  Watched silent;
  Add(&ends);
  Add(&silent);
  auto viewer = watch_.Add({.identity = {.role = Role::kOperator}, .not_after = Wall()},
                           [](const grpc::Status&) {});
  ends.session->greeted = true;
  viewer->greeted = true;

  EXPECT_THAT(watch_.Open(), ElementsAre(Pair(Role::kSensor, 1), Pair(Role::kOperator, 1)));
  ends.session.reset();
  EXPECT_THAT(watch_.Open(), ElementsAre(Pair(Role::kOperator, 1)));
  clock_.Advance(1);
  watch_.CheckSessions();
  EXPECT_THAT(watch_.Open(), IsEmpty()) << "its certificate has expired";
}

TEST_F(SessionWatchTest, AJumpOfTheWallClockIsNoTimeWithoutHello) {
  Watched silent;
  Add(&silent);

  clock_.JumpUnix(3600 * kNanosPerSecond);
  watch_.CheckSessions();
  EXPECT_THAT(silent.ends, IsEmpty());
  clock_.JumpUnix(-7200 * kNanosPerSecond);
  clock_.Advance(kHelloNs + 1);
  watch_.CheckSessions();

  EXPECT_THAT(silent.ends, SizeIs(1));
}

TEST_F(SessionWatchTest, EndsAStreamWhoseCertificateExpiresWhileItLives) {
  Watched session;
  Watched longer;
  Add(&session, Wall() + absl::Hours(1));
  Add(&longer, Wall() + absl::Hours(2));
  session.session->greeted = true;
  longer.session->greeted = true;

  clock_.Advance(3600 * kNanosPerSecond);
  watch_.CheckSessions();
  EXPECT_THAT(session.ends, IsEmpty());  // still in its last instant
  clock_.Advance(1);
  watch_.CheckSessions();

  ASSERT_THAT(session.ends, SizeIs(1));
  EXPECT_EQ(session.ends[0].error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(session.ends[0].error_message(), "the certificate has expired");
  EXPECT_THAT(longer.ends, IsEmpty());
}

TEST_F(SessionWatchTest, AWallClockSetBackProlongsNoCertificate) {
  Watched session;
  Add(&session, Wall() + absl::Hours(1));
  session.session->greeted = true;

  clock_.JumpUnix(-24 * 3600 * kNanosPerSecond);
  watch_.CheckSessions();
  EXPECT_THAT(session.ends, IsEmpty());
  clock_.Advance(3600 * kNanosPerSecond + 1);
  watch_.CheckSessions();

  ASSERT_THAT(session.ends, SizeIs(1));
  EXPECT_EQ(session.ends[0].error_message(), "the certificate has expired");
}

TEST_F(SessionWatchTest, AWallClockSetForwardEndsWhatIsExpiredByIt) {
  Watched session;
  Add(&session, Wall() + absl::Hours(1));
  session.session->greeted = true;

  clock_.JumpUnix(3600 * kNanosPerSecond + 1);
  watch_.CheckSessions();

  EXPECT_THAT(session.ends, SizeIs(1));
}

TEST_F(SessionWatchTest, EndsAStreamThatTheGateTurnsAgainstOnceAndCountsIt) {
  Metrics metrics;
  bool banned = false;
  CallGate gate(
      &clock_,
      [&](const Peer&) -> std::optional<Refusal> {
        if (!banned) return std::nullopt;
        return Refusal{"banned", absl::PermissionDeniedError("the certificate is banned")};
      },
      &metrics);
  std::string refused;
  gate.set_on_refused(
      [&](const Peer&, const Refusal& why, absl::string_view) { refused += why.reason; });
  SessionWatch watch(&clock_, absl::InfiniteDuration(), &gate);
  std::vector<grpc::Status> ends;
  const auto session =
      watch.Add({.identity = {.role = Role::kActuator}, .not_after = absl::InfiniteFuture()},
                [&](const grpc::Status& status) { ends.push_back(status); });
  session->greeted = true;
  watch.CheckSessions();
  EXPECT_THAT(ends, IsEmpty());

  banned = true;
  watch.CheckSessions();
  watch.CheckSessions();

  EXPECT_EQ(refused, "banned");
  ASSERT_THAT(ends, SizeIs(1));
  EXPECT_EQ(ends[0].error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_THAT(metrics.Text(),
              testing::HasSubstr(R"(rips_refused_calls_total{reason="banned",role="actuator"} 1)"));
}

TEST_F(SessionWatchTest, ForgetsAStreamThatIsOver) {
  Watched over;
  Watched open;
  Add(&over);
  Add(&open);
  over.session.reset();

  clock_.Advance(kHelloNs + 1);
  watch_.CheckSessions();
  watch_.CloseAll(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));

  EXPECT_THAT(over.ends, IsEmpty());
  ASSERT_THAT(open.ends, SizeIs(2));
  EXPECT_EQ(open.ends[1].error_message(), "stopping");
}

TEST_F(SessionWatchTest, ClosesAllAfterWhatWaitsButCutsWhatIsDueAtOnce) {
  std::vector<std::string> calls;
  const auto session = watch_.Add(
      {.identity = {}, .not_after = absl::InfiniteFuture()},
      [&](const grpc::Status&) { calls.push_back("close"); },
      [&](const grpc::Status&) { calls.push_back("close when sent"); });
  watch_.CloseAll(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));
  EXPECT_THAT(calls, ElementsAre("close when sent"));
  clock_.Advance(kHelloNs + 1);
  watch_.CheckSessions();
  EXPECT_THAT(calls, ElementsAre("close when sent", "close"));
}

TEST_F(SessionWatchTest, LooksByItselfAtTheInterval) {
  BoundedQueue<grpc::Status> ends({.capacity = 1});
  SessionWatch watch(&clock_, absl::Milliseconds(1));
  const auto session = watch.Add({.identity = {}, .not_after = absl::InfiniteFuture()},
                                 [&](const grpc::Status& status) { ends.Push(status); });

  clock_.Advance(kHelloNs + 1);

  const auto end = ends.Pop(absl::Seconds(30));
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
}

}  // namespace
}  // namespace rips::rpc
