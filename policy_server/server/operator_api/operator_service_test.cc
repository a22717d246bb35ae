// The limits of the operators' service, over real gRPC.
#include "policy_server/server/operator_api/operator_service.h"

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using pipeline::Lane;
using ::testing::HasSubstr;
constexpr absl::Duration kPatience = absl::Seconds(60);
// Calls on one connection: below the server's limit, beyond which a client waits without an error.
constexpr size_t kCallsPerChannel = 90;

// A store whose lists take until the test lets them.
class SlowStore final : public store::Store {
 public:
  using Store::Acquire;
  absl::StatusOr<store::RobotRecord> Load(absl::string_view robot) override {
    return inner_.Load(robot);
  }
  absl::StatusOr<std::vector<store::Acquired>> Acquire(
      std::span<const std::string> robots) override {
    return inner_.Acquire(robots);
  }
  absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t tenure,
                                    uint64_t above) override {
    return inner_.NextTerm(robot, tenure, above);
  }
  absl::StatusOr<std::optional<std::string>> FindDecision(absl::string_view robot,
                                                          const DecisionId& decision_id) override {
    return inner_.FindDecision(robot, decision_id);
  }
  absl::Status BeginGeneration(absl::string_view id) override { return inner_.BeginGeneration(id); }
  absl::StatusOr<std::vector<store::Generation>> Generations() override {
    return inner_.Generations();
  }
  uint64_t newest_commit() const override { return inner_.newest_commit(); }
  absl::StatusOr<std::vector<absl::Status>> CommitAll(
      std::span<const store::WriteBatch> batches) override {
    return inner_.CommitAll(batches);
  }
  absl::StatusOr<std::vector<store::TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                       uint32_t limit) override {
    reading.Push(1);
    gate.Pop(kPatience);
    return inner_.ListTransitions(robot, limit);
  }
  absl::StatusOr<std::vector<store::AlertRecord>> ListAlerts(absl::string_view robot,
                                                             uint32_t limit) override {
    return inner_.ListAlerts(robot, limit);
  }
  absl::StatusOr<store::AlertPage> AlertsAfter(absl::string_view robot, uint64_t sequence,
                                               uint32_t limit) override {
    return inner_.AlertsAfter(robot, sequence, limit);
  }
  absl::StatusOr<std::vector<store::ReceiptRecord>> ListReceipts(absl::string_view robot,
                                                                 uint32_t most) override {
    return inner_.ListReceipts(robot, most);
  }
  absl::StatusOr<store::FoundRecords> FindRecords(absl::string_view prefix) override {
    return inner_.FindRecords(prefix);
  }
  absl::StatusOr<uint64_t> FindAlert(absl::string_view id) override { return inner_.FindAlert(id); }
  absl::StatusOr<store::AlertRecord> NewestAlert() override { return inner_.NewestAlert(); }
  absl::StatusOr<std::string> Note(absl::string_view name) override { return inner_.Note(name); }
  absl::Status SetNote(absl::string_view name, absl::string_view value) override {
    return inner_.SetNote(name, value);
  }

  // One item per list that has begun.
  BoundedQueue<int> reading{{.capacity = 10'000}};
  // Closed, it holds nobody back.
  BoundedQueue<int> gate{{.capacity = 1}};

 private:
  store::FakeStore inner_;
};

// Lists of transitions that are under way together.
struct Lists {
  struct Call {
    grpc::ClientContext context;
    rips::v1::ListTransitionsRequest request;
    rips::v1::ListTransitionsResponse response;
  };
  std::vector<std::unique_ptr<Call>> calls;
  BoundedQueue<grpc::Status> ends{{.capacity = 10'000}};
  size_t ended = 0;

  // How the next one ended.
  grpc::Status Next() {
    const auto end = ends.Pop(kPatience);
    if (!end) return grpc::Status(grpc::StatusCode::UNKNOWN, "none has ended");
    ++ended;
    return *end;
  }
};

class OperatorServiceTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    pki_ = new rpc::TestPki();
    server_credentials_ = new auto(*rpc::Credentials::Load(pki_->Server()));
    operator_credentials_ = new auto(*rpc::Credentials::Load(pki_->Operator()));
  }
  static void TearDownTestSuite() {
    delete operator_credentials_;
    delete server_credentials_;
    delete pki_;
  }

  void SetUp() override {
    lang::CompileResult compiled =
        lang::Compile({{.path = "test.rul", .text = pipeline::kPaperRules}});
    ASSERT_TRUE(compiled.rules);
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_THAT(program, IsOk());
    ASSERT_THAT(pipeline_.Add({.id = "r1",
                               .sensor_hosts = {"base"},
                               .primary_sensor = "base",
                               .actuator_hosts = {"base"}},
                              {.program = *program, .bundle_id = "sha256:0"}, {}, {}, 1,
                              {.recorder = &recorder_, .audience = &hub_, .new_id = NewId}),
                IsOk());
    pipeline_.Start();
    service_ = std::make_unique<OperatorService>(
        &pipeline_, &store_, &hub_,
        OperatorService::Access{
            .watch = &watch_,
            .fields_refused = wire_limits::LimitCounters(&metrics_),
            .on_refused_field = [this](const rpc::Peer&, const auto&,
                                       const auto& what) { refused_fields_.Push(what); },
            .quota = quota_},
        absl::Milliseconds(500));
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*server_credentials_)->ForServer()},
        {service_.get()});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  void TearDown() override {
    store_.gate.Close();
    while (lists_.ended < lists_.calls.size()) lists_.Next();
    server_.reset();
    service_.reset();
    pipeline_.Stop();
  }

  using Stub = rips::v1::OperatorService::Stub;
  std::shared_ptr<Stub> Connect() {
    return rips::v1::OperatorService::NewStub(
        rpc::MakeChannel(server_->address(), (*operator_credentials_)->ForClient()));
  }
  // A stub for the `n`th of many calls, each on a connection with few others.
  Stub& StubFor(size_t n) {
    while (stubs_.size() <= n / kCallsPerChannel) stubs_.push_back(Connect());
    return *stubs_[n / kCallsPerChannel];
  }
  // Runs on the robot's thread; returns when it has.
  absl::Status OnRobot(std::function<void(pipeline::Robot&)> task) {
    BoundedQueue<int> done{{.capacity = 1}};
    const absl::Status posted = pipeline_.Post("r1", Lane::kControl, [&](pipeline::Robot& robot) {
      task(robot);
      done.Push(1);
    });
    if (posted.ok()) done.Pop(kPatience);
    return posted;
  }
  static void SetDeadline(grpc::ClientContext& context) {
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kPatience));
  }

  void List() {
    Lists::Call& call = *lists_.calls.emplace_back(std::make_unique<Lists::Call>());
    SetDeadline(call.context);
    call.context.set_wait_for_ready(true);  // on a machine that has much to do
    call.request.set_robot("r1");
    StubFor(lists_.calls.size())
        .async()
        ->ListTransitions(&call.context, &call.request, &call.response,
                          [this](grpc::Status status) { lists_.ends.Push(std::move(status)); });
  }
  // One is being read, as many wait as may, and `over` more.
  void FillReads(size_t over) {
    List();
    ASSERT_TRUE(store_.reading.Pop(kPatience).has_value());
    for (size_t i = 0; i < OperatorService::kReadsMax + over; ++i) List();
    for (size_t i = 0; i < over; ++i) {
      const grpc::Status end = lists_.Next();
      EXPECT_EQ(end.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
      EXPECT_THAT(end.error_message(), HasSubstr("1024 reads of the store wait already"));
    }
  }

  static rpc::TestPki* pki_;
  static std::shared_ptr<const rpc::Credentials>* server_credentials_;
  static std::shared_ptr<const rpc::Credentials>* operator_credentials_;
  RealClock clock_;
  SlowStore store_;
  StatusBroadcaster hub_{&store_, nullptr};
  pipeline::FakeRecorder recorder_;
  Metrics metrics_;
  BoundedQueue<std::string> refused_fields_{{.capacity = 10}};
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&clock_};
  std::shared_ptr<CallerQuota> quota_;
  std::unique_ptr<OperatorService> service_;
  std::unique_ptr<rpc::RpcServer> server_;
  std::vector<std::shared_ptr<Stub>> stubs_;
  Lists lists_;
};
rpc::TestPki* OperatorServiceTest::pki_ = nullptr;
std::shared_ptr<const rpc::Credentials>* OperatorServiceTest::server_credentials_ = nullptr;
std::shared_ptr<const rpc::Credentials>* OperatorServiceTest::operator_credentials_ = nullptr;

// A watch of the robots, or of alerts.
template <typename T>
struct Watch {
  T item;
  grpc::ClientContext context;
  std::unique_ptr<grpc::ClientReader<T>> reader;

  bool Read() { return reader->Read(&item); }
  grpc::Status End() {
    while (Read()) {
    }
    return reader->Finish();
  }
};

TEST_F(OperatorServiceTest, RefusesOneWatchTooManyUntilAnotherEnds) {
  const auto watch_robots = [&](Stub& stub) {
    auto watch = std::make_unique<Watch<rips::v1::RobotStatus>>();
    SetDeadline(watch->context);
    watch->reader = stub.WatchRobots(&watch->context, {});
    return watch;
  };
  std::vector<std::unique_ptr<Watch<rips::v1::RobotStatus>>> watches;
  for (size_t i = 0; i < StatusBroadcaster::kWatchersMax; ++i)
    watches.push_back(watch_robots(StubFor(i)));
  for (const auto& watch : watches) {
    ASSERT_TRUE(watch->Read());  // from here on it counts
    EXPECT_EQ(watch->item.robot(), "r1");
  }

  const grpc::Status refused = watch_robots(StubFor(StatusBroadcaster::kWatchersMax))->End();
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(refused.error_message(), HasSubstr("256 operators watch already"));
  Watch<rips::v1::Alert> alerts;
  SetDeadline(alerts.context);
  alerts.reader = StubFor(StatusBroadcaster::kWatchersMax).WatchAlerts(&alerts.context, {});
  EXPECT_EQ(alerts.End().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);

  // Nothing happens on the robot meanwhile: leaving alone makes room.
  watches[7]->context.TryCancel();
  EXPECT_EQ(watches[7]->End().error_code(), grpc::StatusCode::CANCELLED);
  const int64_t deadline_ns = BoottimeAfter(kPatience);
  while (true) {
    watches[7] = watch_robots(StubFor(StatusBroadcaster::kWatchersMax));
    if (watches[7]->Read()) break;  // the server may learn of the end later than its peer
    ASSERT_EQ(watches[7]->End().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
    ASSERT_LT(BoottimeNow(), deadline_ns);
  }

  EXPECT_EQ(watches[7]->item.robot(), "r1");
  EXPECT_EQ(watch_robots(StubFor(StatusBroadcaster::kWatchersMax))->End().error_code(),
            grpc::StatusCode::RESOURCE_EXHAUSTED);
}

class OperatorQuotaTest : public OperatorServiceTest {
 protected:
  OperatorQuotaTest() {
    quota_ = CallerQuota::Create(&clock_,
                                 {.streams = {.at_a_time = 2, .per_second = 100, .burst = 100},
                                  .queries = {.at_a_time = 100, .per_second = 1e-9, .burst = 10}});
  }
};

TEST_F(OperatorQuotaTest, AGraphIsSentWhileItsRobotsThreadHangsAndRefusedBeyondTheQuota) {
  BoundedQueue<int> blocked{{.capacity = 1}};
  BoundedQueue<int> gate{{.capacity = 1}};
  ASSERT_THAT(pipeline_.Post("r1", Lane::kControl,
                             [&](pipeline::Robot&) {
                               blocked.Push(1);
                               gate.Pop(kPatience);
                             }),
              IsOk());
  ASSERT_TRUE(blocked.Pop(kPatience).has_value());
  rips::v1::GetGraphRequest request;
  request.set_robot("r1");
  for (int i = 0; i < 3; ++i) {
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::GetGraphResponse response;
    const grpc::Status status = Connect()->GetGraph(&context, request, &response);
    EXPECT_EQ(status.error_code(),
              i < 2 ? grpc::StatusCode::OK : grpc::StatusCode::RESOURCE_EXHAUSTED)
        << status.error_message();
  }
  gate.Close();
  // Orders have an account of their own.
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::LevelRequest raise;
  raise.set_robot("r1");
  raise.set_to("HALT");
  raise.set_reason("drill");
  rips::v1::LevelResponse response;
  const grpc::Status raised = Connect()->Raise(&context, raise, &response);
  EXPECT_TRUE(raised.ok()) << raised.error_message();
}

TEST_F(OperatorQuotaTest, AStreamThatEndsIsGivenBack) {
  const int64_t deadline_ns = BoottimeAfter(kPatience);
  const auto stub = Connect();
  for (int i = 0; i < 5;) {
    Watch<rips::v1::RobotStatus> first, second, third;
    for (auto* watch : {&first, &second, &third}) {
      SetDeadline(watch->context);
      watch->reader = stub->WatchRobots(&watch->context, {});
    }
    int refused = 0;
    for (auto* watch : {&first, &second, &third}) {
      if (watch->Read()) continue;
      EXPECT_EQ(watch->End().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
      ++refused;
      watch->reader = nullptr;
    }
    EXPECT_GE(refused, 1);
    for (auto* watch : {&first, &second, &third}) {
      if (watch->reader == nullptr) continue;
      watch->context.TryCancel();
      watch->End();
    }
    // The server may learn of the end later than its peer.
    i += refused == 1 ? 1 : 0;
    ASSERT_LT(BoottimeNow(), deadline_ns);
  }
}

TEST_F(OperatorServiceTest, SaysWhichRobotsDidNotAnswer) {
  BoundedQueue<int> blocked{{.capacity = 1}};
  BoundedQueue<int> gate{{.capacity = 1}};
  ASSERT_THAT(pipeline_.Post("r1", Lane::kControl,
                             [&](pipeline::Robot&) {
                               blocked.Push(1);
                               gate.Pop(kPatience);
                             }),
              IsOk());
  ASSERT_TRUE(blocked.Pop(kPatience).has_value());
  ASSERT_THAT(pipeline_.Hold({.robot = "r0", .decided_level = "HALT", .degraded = {"no policy"}},
                             absl::FailedPreconditionError("no policy")),
              IsOk());
  const auto list = [&](rips::v1::ListRobotsResponse& response) {
    grpc::ClientContext context;
    SetDeadline(context);
    return Connect()->ListRobots(&context, {}, &response);
  };
  rips::v1::ListRobotsResponse response;
  ASSERT_TRUE(list(response).ok());
  ASSERT_EQ(response.robots_size(), 1);
  EXPECT_EQ(response.robots(0).robot(), "r0");
  EXPECT_EQ(response.robots(0).degraded(0), "no policy");
  ASSERT_EQ(response.no_answer_size(), 1);
  EXPECT_EQ(response.no_answer(0), "r1");

  gate.Close();
  ASSERT_THAT(OnRobot([](pipeline::Robot&) {}), IsOk());
  response.Clear();
  ASSERT_TRUE(list(response).ok());
  EXPECT_EQ(response.robots_size(), 2);
  EXPECT_EQ(response.no_answer_size(), 0);
}

TEST_F(OperatorServiceTest, AWatchOfAlertsResumesAfterItsCursor) {
  const auto raise = [&](const std::string& text) {
    store::WriteBatch batch{.robot = "r1"};
    batch.alerts.push_back({.id = NewId(), .robot = "r1", .text = text});
    ASSERT_THAT(store_.Commit(batch), IsOk());
    hub_.OnAlert(batch.alerts[0]);
  };
  raise("before");
  std::string cursor;
  {
    Watch<rips::v1::Alert> watch;
    SetDeadline(watch.context);
    watch.reader = StubFor(0).WatchAlerts(&watch.context, {});
    ASSERT_TRUE(watch.Read());
    EXPECT_EQ(watch.item.id(), "");
    EXPECT_NE(watch.item.cursor(), "") << "first where it begins";
    raise("one");
    ASSERT_TRUE(watch.Read());
    EXPECT_EQ(watch.item.text(), "one");
    cursor = watch.item.cursor();
    watch.context.TryCancel();
    watch.End();
  }
  raise("two");
  raise("three");
  Watch<rips::v1::Alert> watch;
  SetDeadline(watch.context);
  rips::v1::WatchAlertsRequest request;
  request.set_after(cursor);
  watch.reader = StubFor(0).WatchAlerts(&watch.context, request);
  ASSERT_TRUE(watch.Read());
  EXPECT_EQ(watch.item.cursor(), cursor);
  for (const char* text : {"two", "three"}) {
    ASSERT_TRUE(watch.Read());
    EXPECT_EQ(watch.item.text(), text);
  }
  watch.context.TryCancel();
  watch.End();

  Watch<rips::v1::Alert> wrong;
  SetDeadline(wrong.context);
  request.set_after("nonsense");
  wrong.reader = StubFor(0).WatchAlerts(&wrong.context, request);
  EXPECT_EQ(wrong.End().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(OperatorServiceTest, RefusesReadsBeyondTheLimitAtOnceAndAnswersTheRest) {
  ASSERT_NO_FATAL_FAILURE(FillReads(20));
  EXPECT_EQ(lists_.ends.size(), 0u);

  store_.gate.Close();

  for (size_t i = 0; i < OperatorService::kReadsMax + 1; ++i) {
    const grpc::Status end = lists_.Next();
    EXPECT_TRUE(end.ok()) << end.error_message();
  }
}

TEST_F(OperatorServiceTest, LevelsCanBeChangedWhileReadsWait) {
  ASSERT_NO_FATAL_FAILURE(FillReads(1));
  const std::shared_ptr<Stub> stub = Connect();

  grpc::ClientContext raise;
  SetDeadline(raise);
  rips::v1::LevelRequest request;
  request.set_robot("r1");
  request.set_to("HALT");
  request.set_reason("drill");
  rips::v1::LevelResponse response;
  const grpc::Status raised = stub->Raise(&raise, request, &response);
  EXPECT_TRUE(raised.ok()) << raised.error_message();
  EXPECT_EQ(response.decided_level(), "HALT");

  // Its answer ends with the newest transition, which must be read.
  grpc::ClientContext get;
  SetDeadline(get);
  rips::v1::GetLevelRequest which;
  which.set_robot("r1");
  rips::v1::GetLevelResponse level;
  EXPECT_EQ(stub->GetLevel(&get, which, &level).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
}

TEST_F(OperatorServiceTest, ARequestWithAFieldPastItsLimitIsRefusedCountedAndTold) {
  grpc::ClientContext raise;
  SetDeadline(raise);
  rips::v1::LevelRequest request;
  request.set_robot("r1");
  request.set_to("HALT");
  request.set_reason(std::string(1'001, 'S'));
  rips::v1::LevelResponse response;
  const grpc::Status raised = StubFor(0).Raise(&raise, request, &response);
  EXPECT_EQ(raised.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(raised.error_message(), "LevelRequest.reason has 1001 bytes; at most 1000");
  EXPECT_THAT(metrics_.Text(),
              HasSubstr("rips_fields_refused_total{field=\"LevelRequest.reason\"} 1"));
  ASSERT_EQ(refused_fields_.size(), 1u);
  EXPECT_EQ(refused_fields_.Pop(kPatience), raised.error_message());

  Watch<rips::v1::RobotStatus> watch;
  SetDeadline(watch.context);
  rips::v1::WatchRobotsRequest robots;
  for (int i = 0; i < 2'001; ++i) robots.add_robots("r1");
  watch.reader = StubFor(0).WatchRobots(&watch.context, robots);
  EXPECT_EQ(watch.End().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(OperatorServiceTest, ARobotThatSaysTooMuchIsListedWithoutIt) {
  auto actuator = std::make_shared<pipeline::FakeActuator>();
  ASSERT_THAT(OnRobot([&](pipeline::Robot& robot) {
                robot.OnActuatorHello(
                    "base", actuator,
                    {.levels = robot.core().levels().names(), .effective_level = "DEFAULT"});
                robot.OnActuatorHeartbeat(
                    "base", actuator.get(),
                    {.effective_level = "DEFAULT", .floor_reason = std::string(5 << 20, 'x')});
              }),
              IsOk());
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::ListRobotsResponse response;
  const grpc::Status status =
      StubFor(0).ListRobots(&context, rips::v1::ListRobotsRequest(), &response);
  ASSERT_TRUE(status.ok()) << status.error_message();
  ASSERT_EQ(response.robots_size(), 1);
  EXPECT_EQ(response.robots(0).robot(), "r1");
  EXPECT_TRUE(response.robots(0).degraded_cut());
}

TEST_F(OperatorServiceTest, TellsWhatIsAskedOfTheSensors) {
  auto sensor = std::make_shared<pipeline::FakeSensor>();
  ASSERT_THAT(OnRobot([&](pipeline::Robot& robot) {
                robot.OnSensorHello("base", sensor, {.incarnation = std::string(16, 'i')});
                robot.OnInterestAnswer("base", sensor.get(),
                                       {.id = sensor->interest_id(), .problem = "why\n"});
              }),
              IsOk());
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::GetInterestRequest request;
  request.set_robot("r1");
  rips::v1::GetInterestResponse response;
  const grpc::Status status = Connect()->GetInterest(&context, request, &response);
  ASSERT_TRUE(status.ok()) << status.error_message();
  ASSERT_EQ(response.interest().rules_size(), 2);
  EXPECT_EQ(response.interest().id().size(), 32u);
  EXPECT_EQ(response.interest().rules(0).topic_regex(), "^\\/cmd_vel$");
  EXPECT_EQ(response.interest().rules(0).depth(), rips::v1::InterestRule::METADATA);
  ASSERT_EQ(response.reasons_size(), 2);
  EXPECT_EQ(response.reasons(0).wanted_by(0), "rogue");
  EXPECT_EQ(response.reasons(1).wanted_by_size(), 0);
  ASSERT_EQ(response.sensors_size(), 1);
  EXPECT_EQ(response.sensors(0).host(), "base");
  EXPECT_TRUE(response.sensors(0).connected());
  EXPECT_FALSE(response.sensors(0).in_use());
  EXPECT_EQ(response.sensors(0).problem(), "why\\x0a");
}

TEST_F(OperatorServiceTest, TellsWhatIsSeen) {
  const Instant connected = clock_.Now();
  auto sensor = std::make_shared<pipeline::FakeSensor>();
  ros2::GraphDelta graph;
  ros2::Guid participant;
  participant.bytes = {1, 0x10, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
  graph.upsert_participants.push_back({.guid = participant});
  for (const char* name : {"/b", "/a"}) {
    ros2::Guid guid = participant;
    guid.bytes[14] = static_cast<uint8_t>(name[1]);
    guid.bytes[15] = 3;
    graph.upsert_endpoints.push_back({.guid = guid,
                                      .name = name,
                                      .type = "a/msg/A",
                                      .visibility = ros2::Visibility::kNotVisible,
                                      .why = "why"});
  }
  const std::string incarnation(16, 'i');
  pipeline::Batch batch{.incarnation = incarnation, .lane = Lane::kControl, .first_sequence = 1};
  batch.observations.push_back(
      {.boottime_ns = BoottimeNow(),
       .what = pipeline::GraphChange{.to_version = 1, .settled = true, .delta = graph}});
  batch.observations.push_back(
      {.boottime_ns = BoottimeNow(), .what = pipeline::LossSeen{.count = 3}});
  batch.observations.push_back({.boottime_ns = BoottimeNow(),
                                .what = pipeline::SensorStateSeen{.outbox_bytes = 5,
                                                                  .oldest_unacked_ns = 6,
                                                                  .spool_bytes = 7,
                                                                  .not_visible = {"x"},
                                                                  .blind = {"log"}}});
  ASSERT_THAT(OnRobot([&](pipeline::Robot& robot) {
                robot.OnSensorHello("base", sensor,
                                    {.incarnation = incarnation, .clock = connected});
                robot.OnBatch("base", sensor.get(),
                              std::make_shared<const pipeline::Batch>(std::move(batch)));
                robot.OnSensorHeartbeat("base", sensor.get(), {.clock = clock_.Now()});
              }),
              IsOk());
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::GetCoverageRequest request;
  request.set_robot("r1");
  rips::v1::GetCoverageResponse response;
  const grpc::Status status = Connect()->GetCoverage(&context, request, &response);
  ASSERT_TRUE(status.ok()) << status.error_message();
  ASSERT_EQ(response.sensors_size(), 1);
  const rips::v1::SensorCoverage& base = response.sensors(0);
  EXPECT_TRUE(base.primary() && base.connected() && base.settled());
  EXPECT_EQ(base.not_visible(0), "x");
  EXPECT_EQ(base.state().outbox_bytes(), 5u);
  EXPECT_EQ(base.state().oldest_unacked_ns(), 6u);
  EXPECT_EQ(base.state().spool_bytes(), 7u);
  EXPECT_EQ(base.lost(), 3u);
  EXPECT_TRUE(base.has_clock_skew_ns());
  ASSERT_EQ(response.endpoints_size(), 2);
  EXPECT_EQ(response.endpoints(0).name(), "/a");
  EXPECT_EQ(response.endpoints(1).why(), "why");
  EXPECT_EQ(response.findings_size(), 0);
  EXPECT_FALSE(response.graph_truncated());
  EXPECT_EQ(base.state().blind(0), "log");
  ASSERT_EQ(response.blind_size(), 1);
  EXPECT_EQ(response.blind(0), "sensor base: log");
}

TEST_F(OperatorServiceTest, TellsNothingOfARobotThatIsNone) {
  const std::shared_ptr<Stub> stub = Connect();
  grpc::ClientContext interest;
  SetDeadline(interest);
  rips::v1::GetInterestResponse needed;
  EXPECT_EQ(stub->GetInterest(&interest, {}, &needed).error_code(), grpc::StatusCode::NOT_FOUND);
  grpc::ClientContext coverage;
  SetDeadline(coverage);
  rips::v1::GetCoverageResponse seen;
  EXPECT_EQ(stub->GetCoverage(&coverage, {}, &seen).error_code(), grpc::StatusCode::NOT_FOUND);
  grpc::ClientContext receipts;
  SetDeadline(receipts);
  rips::v1::ListReceiptsResponse answered;
  EXPECT_EQ(stub->ListReceipts(&receipts, {}, &answered).error_code(), grpc::StatusCode::NOT_FOUND);
  grpc::ClientContext drill;
  SetDeadline(drill);
  rips::v1::DrillRobotResponse drilled;
  EXPECT_EQ(stub->DrillRobot(&drill, {}, &drilled).error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST_F(OperatorServiceTest, AMisspeltRobotIsAnErrorAndNotSilence) {
  store_.gate.Close();
  const std::shared_ptr<Stub> stub = Connect();
  const auto code_of = [&](auto method, auto request, auto response, const char* robot) {
    grpc::ClientContext context;
    SetDeadline(context);
    request.set_robot(robot);
    request.set_limit(10);
    return ((*stub).*method)(&context, request, &response).error_code();
  };
  const auto alerts_of = [&](const char* robot) {
    return code_of(&Stub::ListAlerts, rips::v1::ListAlertsRequest(), rips::v1::ListAlertsResponse(),
                   robot);
  };
  const auto history_of = [&](const char* robot) {
    return code_of(&Stub::ListTransitions, rips::v1::ListTransitionsRequest(),
                   rips::v1::ListTransitionsResponse(), robot);
  };
  EXPECT_EQ(alerts_of("r1"), grpc::StatusCode::OK) << "it has none";
  EXPECT_EQ(alerts_of("(server)"), grpc::StatusCode::OK);
  EXPECT_EQ(alerts_of("rl"), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(history_of("r1"), grpc::StatusCode::OK);
  EXPECT_EQ(history_of("rl"), grpc::StatusCode::NOT_FOUND);
  store::WriteBatch batch{.robot = "removed"};
  batch.alerts.push_back({.id = NewId(), .robot = "removed", .text = "x"});
  ASSERT_THAT(store_.Commit(batch), IsOk());
  EXPECT_EQ(alerts_of("removed"), grpc::StatusCode::OK) << "what is stored can be read";
}

TEST_F(OperatorServiceTest, AMisspeltRobotIsNotWatched) {
  Watch<rips::v1::RobotStatus> watch;
  SetDeadline(watch.context);
  rips::v1::WatchRobotsRequest request;
  request.add_robots("r1");
  request.add_robots("rl");
  watch.reader = StubFor(0).WatchRobots(&watch.context, request);
  EXPECT_FALSE(watch.Read());
  EXPECT_EQ(watch.reader->Finish().error_code(), grpc::StatusCode::NOT_FOUND);
}

// Answers each drill at once, on the robot's thread, with one step that failed.
struct DrilledActuator final : pipeline::ActuatorLink {
  void Grant(const pipeline::LeaseGrant&) override {}
  void Send(const pipeline::Command& command) override { commands.Push(command); }
  void Close(const absl::Status&) override {}
  BoundedQueue<pipeline::Command> commands{{.capacity = 100}};
};

TEST_F(OperatorServiceTest, DrillsAndListsReceipts) {
  auto link = std::make_shared<DrilledActuator>();
  ASSERT_THAT(OnRobot([&](pipeline::Robot& robot) {
                robot.OnActuatorHello("base", link,
                                      {.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"},
                                       .effective_level = "DEFAULT"});
              }),
              IsOk());
  const std::shared_ptr<Stub> stub = Connect();
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::DrillRobotRequest request;
  request.set_robot("r1");
  request.set_level("ALERT");
  rips::v1::DrillRobotResponse response;
  BoundedQueue<grpc::Status> ended{{.capacity = 1}};
  stub->async()->DrillRobot(&context, &request, &response,
                            [&](grpc::Status status) { ended.Push(std::move(status)); });
  std::optional<pipeline::Command> command;
  do {
    command = link->commands.Pop(kPatience);
    ASSERT_TRUE(command.has_value());
  } while (!std::holds_alternative<pipeline::Drill>(command->what));

  // Meanwhile others are answered: nothing waits on the robot's thread.
  grpc::ClientContext second;
  SetDeadline(second);
  rips::v1::DrillRobotResponse none;
  const grpc::Status refused = stub->DrillRobot(&second, request, &none);
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_THAT(refused.error_message(), HasSubstr("a drill of r1 by"));

  using Told = pipeline::Receipt::Stage;
  ASSERT_THAT(OnRobot([&](pipeline::Robot& robot) {
                robot.OnReceipt("base", link.get(),
                                {.command_id = command->id,
                                 .stage = Told::kFailed,
                                 .steps = {{.step = "program horn",
                                            .took_ms = 7,
                                            .detail = "not \xff there",
                                            .drilled = pipeline::Drilled::kLooked,
                                            .output_tail = "\xff"}},
                                 .detail = "in short"});
              }),
              IsOk());
  const std::optional<grpc::Status> end = ended.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  ASSERT_TRUE(end->ok()) << end->error_message();
  ASSERT_EQ(response.drills_size(), 1);
  EXPECT_EQ(response.drills(0).level(), "ALERT");
  EXPECT_EQ(response.drills(0).host(), "base");
  EXPECT_EQ(response.drills(0).stage(), rips::v1::Receipt::FAILED);
  EXPECT_EQ(response.drills(0).detail(), "in short");
  ASSERT_EQ(response.drills(0).steps_size(), 1);
  const rips::v1::StepResult& step = response.drills(0).steps(0);
  EXPECT_EQ(step.detail(), "not \\xff there");
  EXPECT_EQ(step.output_tail(), "\xff");
  EXPECT_EQ(step.took_ms(), 7u);
  EXPECT_EQ(step.drilled(), rips::v1::StepResult::DRILLED_LOOKED);

  grpc::ClientContext list;
  SetDeadline(list);
  rips::v1::ListReceiptsRequest which;
  which.set_robot("r1");
  which.set_limit(1);
  rips::v1::ListReceiptsResponse receipts;
  ASSERT_TRUE(stub->ListReceipts(&list, which, &receipts).ok());
  ASSERT_EQ(receipts.receipts_size(), 1);
  EXPECT_EQ(receipts.receipts(0).command(), "drill ALERT");
  EXPECT_EQ(receipts.receipts(0).host(), "base");
  EXPECT_EQ(receipts.receipts(0).receipt().stage(), rips::v1::Receipt::FAILED);
  EXPECT_EQ(receipts.receipts(0).receipt().command_id().size(), 16u);
  EXPECT_EQ(receipts.receipts(0).receipt().steps_size(), 1);
  EXPECT_GT(receipts.receipts(0).unix_ns(), 0);
}

TEST_F(OperatorServiceTest, DrillsAreRefusedWithWords) {
  const std::shared_ptr<Stub> stub = Connect();
  rips::v1::DrillRobotRequest request;
  request.set_robot("r1");
  rips::v1::DrillRobotResponse response;
  grpc::ClientContext nobody;
  SetDeadline(nobody);
  grpc::Status status = stub->DrillRobot(&nobody, request, &response);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_EQ(status.error_message(), "no actuator of r1 is attached");
  request.set_level("PANIC");
  grpc::ClientContext unknown;
  SetDeadline(unknown);
  status = stub->DrillRobot(&unknown, request, &response);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(status.error_message(), HasSubstr("(DEFAULT, ALERT, COMPROMISED, HALT)"));
}

TEST_F(OperatorServiceTest, AViewerMayReadReceiptsAndNotDrill) {
  const auto viewer = rpc::Credentials::Load(pki_->Operator("viewer", "bob"));
  ASSERT_THAT(viewer, IsOk());
  const auto stub = rips::v1::OperatorService::NewStub(
      rpc::MakeChannel(server_->address(), (*viewer)->ForClient()));
  grpc::ClientContext drill;
  SetDeadline(drill);
  rips::v1::DrillRobotRequest request;
  request.set_robot("r1");
  rips::v1::DrillRobotResponse drilled;
  EXPECT_EQ(stub->DrillRobot(&drill, request, &drilled).error_code(),
            grpc::StatusCode::PERMISSION_DENIED);
  grpc::ClientContext list;
  SetDeadline(list);
  rips::v1::ListReceiptsRequest which;
  which.set_robot("r1");
  rips::v1::ListReceiptsResponse receipts;
  EXPECT_TRUE(stub->ListReceipts(&list, which, &receipts).ok());
  EXPECT_EQ(receipts.receipts_size(), 0);
}

}  // namespace
}  // namespace rips::operator_api
