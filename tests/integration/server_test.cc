// The policy server as its peers meet it: real gRPC, real certificates, real store.
#include "policy_server/server/server.h"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <deque>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <string>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "rips/v1/actuator.grpc.pb.h"
#include "rips/v1/operator.grpc.pb.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/test_pki.h"

namespace rips {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::SizeIs;
using ::testing::StartsWith;

constexpr char kIncarnation[] = "0123456789abcdef";

// One certificate authority for all tests of this binary; another one is the foreign one.
rpc::TestPki& Pki() {
  static auto* pki = new rpc::TestPki;
  return *pki;
}

std::string MakeDirectory() {
  std::string path = absl::StrCat(::testing::TempDir(), "/rips-server-XXXXXX");
  return mkdtemp(path.data());
}

class ServerTest : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ = MakeDirectory();
    std::ofstream(dir_ + "/robots.yaml")
        << "robots:\n  - {id: r1, bundle: warehouse, sensors: [{host: base, primary: true}], "
           "actuators: [base]}\n";
    config_.id = "ps1";
    config_.listen = "127.0.0.1:0";
    config_.trust_domain = "fleet.example";
    config_.tls = Pki().Server("ps1");
    config_.inventory = dir_ + "/robots.yaml";
    config_.bundles_source = RIPS_SOURCE_DIR "/rules";
    config_.bundles_dir = dir_ + "/bundles";
    config_.store_path = dir_ + "/state.db";
    config_.alerts.path = dir_ + "/alerts.jsonl";
    config_.metrics = "127.0.0.1:0";
    Start();
  }
  void Start() {
    auto server = server::Server::Start(config_);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }

  std::shared_ptr<grpc::Channel> Connect(const TlsFiles& files) {
    // Kept: letting go of watched certificate files takes up to a second.
    static auto* loaded = new std::map<std::string, std::shared_ptr<const rpc::Credentials>>;
    std::shared_ptr<const rpc::Credentials>& credentials = (*loaded)[files.cert];
    if (credentials == nullptr) {
      auto fresh = rpc::Credentials::Load(files);
      EXPECT_TRUE(fresh.ok()) << fresh.status();
      credentials = *fresh;
    }
    return rpc::MakeChannel(server_->address(), credentials->ForClient());
  }
  static void SetDeadline(grpc::ClientContext& context, int seconds = 10) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(seconds));
  }

  // A sensor's stream as far as the test drives it.
  struct Sensor {
    explicit Sensor(const std::shared_ptr<grpc::Channel>& channel)
        : stub(rips::v1::SensorService::NewStub(channel)) {
      SetDeadline(context);
      stream = stub->Observe(&context);
    }
    void Hello(const std::string& host = "base", uint32_t protocol = 1,
               const std::string& incarnation = kIncarnation) {
      rips::v1::SensorMessage message;
      auto* hello = message.mutable_hello()->mutable_hello();
      hello->set_protocol(protocol);
      hello->set_incarnation(incarnation);
      hello->set_host(host);
      hello->mutable_clock()->set_boottime_ns(static_cast<uint64_t>(RealClock().Now().boottime_ns));
      stream->Write(message);
    }
    void Send(const rips::v1::ObservationBatch& batch) {
      rips::v1::SensorMessage message;
      *message.mutable_batch() = batch;
      stream->Write(message);
    }
    // Reads up to the first reply of `kind`.
    bool ReadUntil(rips::v1::SensorReply::KindCase kind, rips::v1::SensorReply* reply) {
      while (stream->Read(reply)) {
        if (reply->kind_case() == kind) return true;
      }
      return false;
    }
    // How the server ends the stream.
    grpc::Status End() {
      rips::v1::SensorReply reply;
      while (stream->Read(&reply)) {
      }
      return stream->Finish();
    }
    std::unique_ptr<rips::v1::SensorService::Stub> stub;
    grpc::ClientContext context;
    std::unique_ptr<grpc::ClientReaderWriter<rips::v1::SensorMessage, rips::v1::SensorReply>>
        stream;
  };

  static rips::v1::ObservationBatch Batch(uint64_t first, rips::v1::Lane lane) {
    rips::v1::ObservationBatch batch;
    batch.set_incarnation(kIncarnation);
    batch.set_first_sequence(first);
    batch.set_lane(lane);
    batch.set_base_boottime_ns(static_cast<uint64_t>(RealClock().Now().boottime_ns));
    return batch;
  }
  static rips::v1::ObservationBatch Snapshot() {
    rips::v1::ObservationBatch batch = Batch(1, rips::v1::CONTROL);
    auto* snapshot = batch.add_observations()->mutable_snapshot();
    snapshot->set_graph_version(1);
    snapshot->set_settled(true);
    const std::string participant = absl::StrCat("PARTICIPANT1", std::string("\0\0\x01\xc1", 4));
    snapshot->add_participants()->set_guid(participant);
    auto* node = snapshot->add_nodes();
    node->set_full_name("/intruder");
    node->set_participant_guid(participant);
    return batch;
  }

  std::string dir_;
  server::ServerConfig config_;
  std::unique_ptr<server::Server> server_;
};

TEST_F(ServerTest, JudgesASensorsGraphAndAcknowledgesItWhenDurable) {
  Sensor sensor(Connect(Pki().Sensor()));
  sensor.Hello();
  rips::v1::SensorReply reply;
  ASSERT_TRUE(sensor.ReadUntil(rips::v1::SensorReply::kConfig, &reply));
  EXPECT_TRUE(reply.config().primary());
  EXPECT_TRUE(reply.config().want_snapshot());

  sensor.Send(Snapshot());

  ASSERT_TRUE(sensor.ReadUntil(rips::v1::SensorReply::kAck, &reply));
  EXPECT_EQ(reply.ack().durable_sequence(), 1u);
  auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("viewer", "bob")));
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::ListAlertsRequest request;
  rips::v1::ListAlertsResponse alerts;
  ASSERT_TRUE(operators->ListAlerts(&context, request, &alerts).ok());
  // On a busy machine the agents that this test does not have are missed by now.
  EXPECT_EQ(std::count_if(alerts.alerts().begin(), alerts.alerts().end(),
                          [](const auto& each) { return each.rule() == "stranger_came"; }),
            1);
}

TEST_F(ServerTest, RefusesRobotsAndHostsThatAreNotListed) {
  Sensor other_robot(Connect(Pki().Sensor("r2", "base")));
  other_robot.Hello();
  EXPECT_EQ(other_robot.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);

  Sensor other_host(Connect(Pki().Sensor("r1", "laptop")));
  other_host.Hello("laptop");
  EXPECT_EQ(other_host.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(ServerTest, AHelloCannotClaimAnotherHost) {
  Sensor sensor(Connect(Pki().Sensor()));

  sensor.Hello("laptop");

  EXPECT_EQ(sensor.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(ServerTest, ARoleCannotPlayAnother) {
  Sensor actuator_as_sensor(Connect(Pki().Actuator()));
  actuator_as_sensor.Hello();
  EXPECT_EQ(actuator_as_sensor.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);

  auto actuators = rips::v1::ActuatorService::NewStub(Connect(Pki().Sensor()));
  grpc::ClientContext context;
  SetDeadline(context);
  auto stream = actuators->Attach(&context);
  rips::v1::ActuatorReply reply;
  EXPECT_FALSE(stream->Read(&reply));
  EXPECT_EQ(stream->Finish().error_code(), grpc::StatusCode::PERMISSION_DENIED);

  auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Sensor()));
  grpc::ClientContext list;
  SetDeadline(list);
  rips::v1::ListRobotsResponse robots;
  EXPECT_EQ(operators->ListRobots(&list, {}, &robots).error_code(),
            grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(ServerTest, AViewerMayLookButNotChange) {
  auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("viewer", "bob")));
  grpc::ClientContext list;
  SetDeadline(list);
  rips::v1::ListRobotsResponse robots;
  ASSERT_TRUE(operators->ListRobots(&list, {}, &robots).ok());
  ASSERT_THAT(robots.robots(), SizeIs(1));
  EXPECT_EQ(robots.robots(0).decided_level(), "DEFAULT");

  rips::v1::LevelRequest request;
  request.set_robot("r1");
  request.set_to("HALT");
  request.set_reason("trying");
  rips::v1::LevelResponse response;
  for (const bool raise : {true, false}) {
    grpc::ClientContext context;
    SetDeadline(context);
    const grpc::Status status = raise ? operators->Raise(&context, request, &response)
                                      : operators->DeEscalate(&context, request, &response);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::PERMISSION_DENIED);
    EXPECT_THAT(status.error_message(), HasSubstr("needs the role `operator`"));
  }
}

// Asks for a level, on the connection of `stub`.
grpc::Status ChangeLevel(rips::v1::OperatorService::Stub& stub, const std::string& to) {
  rips::v1::LevelRequest request;
  request.set_robot("r1");
  request.set_to(to);
  request.set_reason("trying");
  rips::v1::LevelResponse response;
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(10));
  return stub.Raise(&context, request, &response);
}

TEST_F(ServerTest, RecordsNameTheCertificateOfAnOrderAlsoOfARefusedOne) {
  auto viewer = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("viewer", "bob")));
  auto admin = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("admin", "carol")));
  EXPECT_EQ(ChangeLevel(*viewer, "HALT").error_code(), grpc::StatusCode::PERMISSION_DENIED);
  ASSERT_TRUE(ChangeLevel(*admin, "ALERT").ok());

  rips::v1::ListTransitionsRequest request;
  request.set_robot("r1");
  rips::v1::ListTransitionsResponse records;
  for (int i = 0; i < 200 && records.transitions_size() < 3; ++i) {  // a refusal is queued
    grpc::ClientContext context;
    SetDeadline(context);
    ASSERT_TRUE(admin->ListTransitions(&context, request, &records).ok());
  }
  ASSERT_THAT(records.transitions(), SizeIs(3));  // the oldest is the first start
  EXPECT_FALSE(records.transitions(0).refused());
  EXPECT_THAT(
      records.transitions(0).cause(),
      MatchesRegex(
          R"(operator carol \(spiffe://fleet\.example/operator/admin/carol serial [0-9a-f]+\))"));
  EXPECT_TRUE(records.transitions(1).refused());
  EXPECT_EQ(records.transitions(1).to(), "HALT");
  EXPECT_THAT(records.transitions(1).cause(),
              HasSubstr("operator bob (spiffe://fleet.example/operator/viewer/bob serial "));
  EXPECT_THAT(records.transitions(1).reason(), HasSubstr("needs the role `operator`"));
}

// As many terminals as one certificate may have, each with a watch; then one more to raise.
TEST_F(ServerTest, AnOrderFindsAConnectionBesideAllWatchesOfItsCertificate) {
  struct Watch {
    std::unique_ptr<rips::v1::OperatorService::Stub> stub;
    grpc::ClientContext context;
    std::unique_ptr<grpc::ClientReader<rips::v1::RobotStatus>> stream;
  };
  const TlsFiles files = Pki().Operator("operator", "watcher");
  std::deque<Watch> watches;
  const auto watch = [&] {
    Watch& each = watches.emplace_back();
    each.stub = rips::v1::OperatorService::NewStub(Connect(files));
    SetDeadline(each.context, 60);
    each.stream = each.stub->WatchRobots(&each.context, {});
    rips::v1::RobotStatus status;
    return each.stream->Read(&status);
  };
  for (int i = 0; i < config_.operators.streams; ++i) ASSERT_TRUE(watch()) << i;
  EXPECT_FALSE(watch());
  EXPECT_EQ(watches.back().stream->Finish().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  const auto order = rips::v1::OperatorService::NewStub(Connect(files));
  EXPECT_TRUE(ChangeLevel(*order, "ALERT").ok());

  std::vector<std::unique_ptr<rips::v1::OperatorService::Stub>> more;
  grpc::Status last;
  while (last.ok() && more.size() < 100) {
    more.push_back(rips::v1::OperatorService::NewStub(Connect(files)));
    rips::v1::GetLevelRequest request;
    request.set_robot("r1");
    rips::v1::GetLevelResponse response;
    grpc::ClientContext context;
    SetDeadline(context);
    last = more.back()->GetLevel(&context, request, &response);
  }
  EXPECT_EQ(last.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(last.error_message(), HasSubstr("48 connections already; close some"));
}

TEST_F(ServerTest, AnExpiredCertificateGetsNothingOnAConnectionThatIsOpen) {
  const TlsFiles brief = Pki().Mint({.folder = "brief-operator",
                                     .san = "URI:spiffe://fleet.example/operator/admin/brief",
                                     .age_seconds = 86'400 - 4});
  const absl::Time not_after = rpc::ReadOwnCertificate(brief)->not_after;
  auto stub = rips::v1::OperatorService::NewStub(Connect(brief));
  ASSERT_TRUE(ChangeLevel(*stub, "ALERT").ok());
  grpc::ClientContext watching;
  SetDeadline(watching, 30);
  auto watch = stub->WatchRobots(&watching, {});
  rips::v1::RobotStatus status;
  ASSERT_TRUE(watch->Read(&status));

  while (watch->Read(&status)) {
  }
  EXPECT_EQ(watch->Finish().error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_GE(absl::Now(), not_after);
  EXPECT_LE(absl::Now(), not_after + absl::Seconds(4));

  const grpc::Status refused = ChangeLevel(*stub, "HALT");
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(refused.error_message(), "the certificate has expired");
}

TEST_F(ServerTest, OnlyAnAdministratorResetsATerm) {
  const auto reset = [&](const TlsFiles& files, const std::string& robot) {
    auto stub = rips::v1::OperatorService::NewStub(Connect(files));
    rips::v1::ResetTermRequest request;
    request.set_robot(robot);
    request.set_host("base");
    request.set_reason("the disk was replaced");
    rips::v1::ResetTermResponse response;
    grpc::ClientContext context;
    SetDeadline(context);
    return stub->ResetTerm(&context, request, &response);
  };
  for (const auto& files :
       {Pki().Operator("viewer", "bob"), Pki().Operator("operator", "dave"), Pki().Sensor()}) {
    EXPECT_EQ(reset(files, "r1").error_code(), grpc::StatusCode::PERMISSION_DENIED);
  }
  const auto admin = Pki().Operator("admin", "carol");
  const grpc::Status unneeded = reset(admin, "r1");
  EXPECT_EQ(unneeded.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_THAT(unneeded.error_message(), HasSubstr("nothing to reset"));
  EXPECT_EQ(reset(admin, "r9").error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST_F(ServerTest, ABanEndsStreamsAndLastsUntilItIsLifted) {
  const std::string uri = "spiffe://fleet.example/robot/r1/sensor/base";
  auto admin = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("admin", "carol")));
  auto other = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("operator", "dave")));
  const auto ban = [&](rips::v1::OperatorService::Stub& stub, const std::string& whom,
                       const std::string& serial = "") {
    rips::v1::BanRequest request;
    request.set_uri(whom);
    request.set_serial(serial);
    request.set_reason("stolen");
    rips::v1::BanResponse response;
    grpc::ClientContext context;
    SetDeadline(context);
    return stub.Ban(&context, request, &response).error_code();
  };
  const auto unban = [&](const std::string& serial = "") {
    rips::v1::UnbanRequest request;
    request.set_uri(uri);
    request.set_serial(serial);
    rips::v1::UnbanResponse response;
    grpc::ClientContext context;
    SetDeadline(context);
    return admin->Unban(&context, request, &response).error_code();
  };
  rips::v1::SensorReply reply;
  Sensor sensor(Connect(Pki().Sensor()));
  sensor.Hello();
  ASSERT_TRUE(sensor.ReadUntil(rips::v1::SensorReply::kConfig, &reply));
  EXPECT_EQ(ban(*other, uri), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(ban(*admin, "spiffe://fleet.example/operator/admin/carol"),
            grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(ban(*admin, "r1"), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(ban(*admin, uri, "0FX"), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(unban(), grpc::StatusCode::NOT_FOUND);

  ASSERT_EQ(ban(*admin, uri), grpc::StatusCode::OK);

  EXPECT_EQ(sensor.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);
  Sensor again(Connect(Pki().Sensor()));
  again.Hello();
  EXPECT_EQ(again.End().error_message(), "the certificate is banned");
  server_->Stop();
  server_.reset();
  ASSERT_NO_FATAL_FAILURE(Start());
  Sensor after_restart(Connect(Pki().Sensor()));
  after_restart.Hello();
  EXPECT_EQ(after_restart.End().error_message(), "the certificate is banned");

  admin = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("admin", "carol")));
  rips::v1::ListAgentsResponse listed;
  grpc::ClientContext list;
  SetDeadline(list);
  ASSERT_TRUE(admin->ListAgents(&list, {}, &listed).ok());
  ASSERT_THAT(listed.bans(), SizeIs(1));
  EXPECT_EQ(listed.bans(0).reason(), "stolen");
  EXPECT_THAT(listed.bans(0).by(), HasSubstr("/operator/admin/carol serial "));
  ASSERT_EQ(unban(), grpc::StatusCode::OK);
  Sensor back(Connect(Pki().Sensor()));
  back.Hello();
  EXPECT_TRUE(back.ReadUntil(rips::v1::SensorReply::kConfig, &reply));

  // Of one certificate: another of the same identity is served.
  ASSERT_EQ(ban(*admin, uri, "0123456789abcdef"), grpc::StatusCode::OK);
  Sensor other_serial(Connect(Pki().Sensor()));
  EXPECT_EQ(ban(*admin, uri, rpc::ReadOwnCertificate(Pki().Sensor())->serial),
            grpc::StatusCode::OK);
  EXPECT_EQ(back.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(ServerTest, ARevokedCertificateIsCutOffWhenTheListIsThere) {
  rpc::TestPki pki;
  server_->Stop();
  server_.reset();
  config_.store_path += "2";
  config_.tls = pki.Server("ps1");
  config_.tls.crl = pki.SignRevocations();
  ASSERT_NO_FATAL_FAILURE(Start());
  const TlsFiles files = pki.Sensor();
  const TlsFiles operator_files = pki.Operator("operator", "dave");
  Sensor sensor(Connect(files));
  sensor.Hello();
  rips::v1::SensorReply reply;
  ASSERT_TRUE(sensor.ReadUntil(rips::v1::SensorReply::kConfig, &reply));
  auto stub = rips::v1::OperatorService::NewStub(Connect(operator_files));
  ASSERT_TRUE(ChangeLevel(*stub, "ALERT").ok());

  pki.Revoke(files);
  pki.Revoke(operator_files);

  const grpc::Status end = sensor.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(end.error_message(), "the certificate is revoked");
  Sensor again(Connect(files));
  again.Hello();
  EXPECT_EQ(again.End().error_message(), "the certificate is revoked");
  grpc::Status refused;
  // The second list may come later; by then the robot may be at HALT already.
  for (int i = 0; i < 100 && !absl::StrContains(refused.error_message(), "revoked"); ++i) {
    refused = ChangeLevel(*stub, "HALT");
    absl::SleepFor(absl::Milliseconds(50));
  }
  EXPECT_EQ(refused.error_message(), "the certificate is revoked");
  Sensor actuator_is_not(Connect(pki.Sensor("r1", "laptop")));
  actuator_is_not.Hello("laptop");
  EXPECT_EQ(actuator_is_not.End().error_code(), grpc::StatusCode::PERMISSION_DENIED)
      << "not listed in the inventory, and not revoked";
}

TEST_F(ServerTest, RefusesAForeignAuthorityAndNoCertificate) {
  rpc::TestPki foreign;
  TlsFiles mixed = foreign.Sensor();
  mixed.ca = Pki().Sensor().ca;
  auto read = [](const std::string& path) {
    std::ifstream in(path);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  for (const bool with_certificate : {true, false}) {
    grpc::SslCredentialsOptions options{.pem_root_certs = read(mixed.ca)};
    if (with_certificate) {
      options.pem_private_key = read(mixed.key);
      options.pem_cert_chain = read(mixed.cert);
    }
    grpc::ChannelArguments arguments;
    auto channel =
        grpc::CreateCustomChannel(server_->address(), grpc::SslCredentials(options), arguments);
    auto operators = rips::v1::OperatorService::NewStub(channel);
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::ListRobotsResponse robots;
    EXPECT_EQ(operators->ListRobots(&context, {}, &robots).error_code(),
              grpc::StatusCode::UNAVAILABLE)
        << with_certificate;
  }
}

TEST_F(ServerTest, PlainTextOnTheTlsPortIsRefusedAndOthersAreServed) {
  auto channel = grpc::CreateChannel(server_->address(), grpc::InsecureChannelCredentials());
  auto plain = rips::v1::OperatorService::NewStub(channel);
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::ListRobotsResponse robots;
  EXPECT_EQ(plain->ListRobots(&context, {}, &robots).error_code(), grpc::StatusCode::UNAVAILABLE);

  auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator()));
  grpc::ClientContext second;
  SetDeadline(second);
  EXPECT_TRUE(operators->ListRobots(&second, {}, &robots).ok());
}

TEST_F(ServerTest, ClosesMalformedStreamsWithAReason) {
  struct Case {
    const char* name;
    std::function<void(Sensor&)> send;
    grpc::StatusCode code;
    const char* text;
  };
  const std::vector<Case> cases = {
      {"no hello", [](Sensor& s) { s.Send(Snapshot()); }, grpc::StatusCode::INVALID_ARGUMENT,
       "must be a hello"},
      {"two hellos", [](Sensor& s) { s.Hello(), s.Hello(); }, grpc::StatusCode::INVALID_ARGUMENT,
       "second hello"},
      {"newer protocol", [](Sensor& s) { s.Hello("base", 2); },
       grpc::StatusCode::FAILED_PRECONDITION, "newer"},
      {"short incarnation", [](Sensor& s) { s.Hello("base", 1, "short"); },
       grpc::StatusCode::INVALID_ARGUMENT, "incarnation has 5 bytes"},
      {"empty batch", [](Sensor& s) { s.Hello(), s.Send(Batch(1, rips::v1::CONTROL)); },
       grpc::StatusCode::INVALID_ARGUMENT, "empty batch"},
      {"gap in control",
       [](Sensor& s) {
         auto batch = Snapshot();
         batch.set_first_sequence(5);
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "is missing"},
      {"no lane",
       [](Sensor& s) {
         auto batch = Snapshot();
         batch.set_lane(rips::v1::LANE_UNSPECIFIED);
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "unknown lane"},
      {"truncated guid",
       [](Sensor& s) {
         auto batch = Snapshot();
         batch.mutable_observations(0)->mutable_snapshot()->mutable_participants(0)->set_guid("x");
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::INVALID_ARGUMENT, ""},
      {"unknown participant",
       [](Sensor& s) {
         auto batch = Snapshot();
         batch.mutable_observations(0)->mutable_snapshot()->clear_participants();
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::INVALID_ARGUMENT, ""},
      {"ids never interned",
       [](Sensor& s) {
         auto batch = Batch(1, rips::v1::MESSAGES);
         batch.add_observations()->mutable_message()->set_topic_id(7);
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "not interned"},
      {"messages before there is credit",
       [](Sensor& s) {
         auto batch = Batch(1, rips::v1::MESSAGES);
         auto* topic = batch.add_interned();
         topic->set_id(1);
         topic->set_topic("/cmd_vel");
         auto* type = batch.add_interned();
         type->set_id(2);
         type->set_type("geometry_msgs/msg/Twist");
         auto* writer = batch.add_interned();
         writer->set_id(3);
         writer->mutable_writer()->set_guid(std::string(16, 'g'));
         writer->mutable_writer()->set_kind(rips::v1::Endpoint::PUBLISHER);
         auto* message = batch.add_observations()->mutable_message();
         message->set_topic_id(1);
         message->set_type_id(2);
         message->set_writer_id(3);
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::RESOURCE_EXHAUSTED, "exceed the credit of 0"},
      {"too many observations",
       [](Sensor& s) {
         auto batch = Batch(1, rips::v1::CONTROL);
         for (int i = 0; i < 257; ++i) batch.add_observations()->mutable_signal()->set_name("x");
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "observations has 257 elements; at most 256"},
      {"too large a message",
       [](Sensor& s) {
         auto batch = Batch(1, rips::v1::CONTROL);
         batch.add_observations()->mutable_signal()->set_name(std::string(5 << 20, 'x'));
         s.Hello(), s.Send(batch);
       },
       grpc::StatusCode::RESOURCE_EXHAUSTED, ""},
  };
  int minted = 0;
  for (const Case& each : cases) {
    grpc::Status status;
    // The server may learn a little later than we do that the former stream has ended, and the
    // connection of a refused message may end before its answer is read.
    for (int attempt = 0; attempt < 100; ++attempt) {
      // A certificate of its own: that of a refused message is banned.
      const auto channel =
          Connect(Pki().Mint({.folder = absl::StrCat("malformed-", ++minted),
                              .san = "URI:spiffe://fleet.example/robot/r1/sensor/base"}));
      Sensor sensor(channel);
      each.send(sensor);
      status = sensor.End();
      if (status.error_code() != grpc::StatusCode::ALREADY_EXISTS &&
          status.error_code() != grpc::StatusCode::UNAVAILABLE) {
        break;
      }
      absl::SleepFor(absl::Milliseconds(100));
    }
    EXPECT_EQ(status.error_code(), each.code) << each.name << ": " << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr(each.text)) << each.name;
  }
}

TEST_F(ServerTest, ARestartKeepsTheLevelAndDrawsAHigherTerm) {
  auto raise = [&] {
    auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("operator", "al")));
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::LevelRequest request;
    request.set_robot("r1");
    request.set_to("COMPROMISED");
    request.set_reason("drill");
    rips::v1::LevelResponse response;
    const grpc::Status status = operators->Raise(&context, request, &response);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return response.decision_id().epoch();
  };
  EXPECT_EQ(raise(), 2u);

  server_.reset();
  Start();

  auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator()));
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::GetLevelRequest request;
  request.set_robot("r1");
  rips::v1::GetLevelResponse level;
  ASSERT_TRUE(operators->GetLevel(&context, request, &level).ok());
  EXPECT_EQ(level.status().decided_level(), "COMPROMISED");
  EXPECT_EQ(level.status().decision_id().term(), 1u);
  EXPECT_THAT(level.last().cause(),
              StartsWith("operator al (spiffe://fleet.example/operator/operator/al serial "));
  EXPECT_EQ(level.last().reason(), "drill");
}

TEST_F(ServerTest, SaysWhatIsWrongWithItsFiles) {
  server_.reset();
  server::ServerConfig config = config_;
  config.tls = Pki().Sensor();
  EXPECT_THAT(server::Server::Start(config).status(),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is the certificate of")));
  config = config_;
  config.inventory = dir_ + "/nowhere.yaml";
  EXPECT_THAT(server::Server::Start(config).status(),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nowhere.yaml")));
}

TEST_F(ServerTest, RefusesToStartWithFewerConnectionsThanItsAgentsNeed) {
  server_.reset();
  server::ServerConfig config = config_;
  config.connections.total = 33;
  EXPECT_THAT(server::Server::Start(config).status(),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("`connections.total` of 33 is too low for the")));
  // In a process of its own: a hard limit cannot be raised again.
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        rlimit low = {};
        low.rlim_cur = low.rlim_max = 550;
        setrlimit(RLIMIT_NOFILE, &low);
        std::cerr << server::Server::Start(config_).status();
        _exit(0);
      },
      ::testing::ExitedWithCode(0), "FAILED_PRECONDITION: the limit of 550 open files is too low");
}

TEST_F(ServerTest, ABundleThatCannotBeReadCostsItsRobotOnlyAndIsSaid) {
  server_.reset();
  config_.bundles_source = dir_;
  Start();  // by the copy that was kept
  auto operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("viewer", "bob")));
  const auto list = [&] {
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::ListRobotsResponse robots;
    EXPECT_TRUE(operators->ListRobots(&context, {}, &robots).ok());
    return robots;
  };
  ASSERT_THAT(list().robots(), SizeIs(1));
  EXPECT_EQ(list().robots(0).decided_level(), "DEFAULT");

  server_.reset();
  config_.bundles_dir = dir_ + "/none";
  Start();
  operators = rips::v1::OperatorService::NewStub(Connect(Pki().Operator("viewer", "bob")));
  ASSERT_THAT(list().robots(), SizeIs(1));
  EXPECT_THAT(list().robots(0).degraded(0), HasSubstr("no policy"));
  Sensor sensor(Connect(Pki().Sensor()));
  sensor.Hello();
  const grpc::Status end = sensor.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_THAT(end.error_message(), HasSubstr("no policy"));
}

TEST_F(ServerTest, ARobotThatIsRemovedWhileConnectedIsClosedWithWordsAndComesBack) {
  Sensor sensor(Connect(Pki().Sensor()));
  sensor.Hello();
  rips::v1::SensorReply reply;
  ASSERT_TRUE(sensor.ReadUntil(rips::v1::SensorReply::kConfig, &reply));
  const auto list_robot = [&](const std::string& id) {
    std::ofstream(dir_ + "/robots.yaml")
        << "robots:\n  - {id: " << id
        << ", bundle: warehouse, sensors: [{host: base, primary: true}], actuators: [base]}\n";
    server_->Reload();
  };
  list_robot("r2");

  const grpc::Status end = sensor.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_THAT(end.error_message(), HasSubstr("robot `r1` was removed from the inventory"));
  Sensor refused(Connect(Pki().Sensor()));
  refused.Hello();
  EXPECT_EQ(refused.End().error_code(), grpc::StatusCode::PERMISSION_DENIED);
  Sensor other(Connect(Pki().Sensor("r2", "base")));
  other.Hello();
  EXPECT_TRUE(other.ReadUntil(rips::v1::SensorReply::kConfig, &reply));

  list_robot("r1");
  Sensor again(Connect(Pki().Sensor()));
  again.Hello();
  EXPECT_TRUE(again.ReadUntil(rips::v1::SensorReply::kConfig, &reply));
}

}  // namespace
}  // namespace rips
