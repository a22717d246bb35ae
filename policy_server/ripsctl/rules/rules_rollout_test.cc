// `ripsctl rules` against a server with robots and bundles on disk: how an operator brings rules
// into force, over mutual TLS.
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "policy_server/policy/bundle/key_samples.h"
#include "policy_server/ripsctl/app.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/rollout/bundle_control_fixture.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

constexpr absl::Duration kPatience = absl::Seconds(60);
// Of which there is nothing to warn.
constexpr char kRules[] =
    "rules Msg:\n"
    "  spy: topicin(\"/spy\") ? trigger(ALERT);\n"
    "  driver: topicin(\"/driver\") ? trigger(HALT);\n";

class RulesRolloutTest : public rollout::BundleControlFixture {
 protected:
  static void SetUpTestSuite() {
    pki_ = new rpc::TestPki();
    server_files_ = new TlsFiles(pki_->Server());
    operator_files_ =
        new std::map<std::string, TlsFiles>{{"admin", pki_->Operator("admin", "alice")},
                                            {"operator", pki_->Operator("operator", "otto")},
                                            {"viewer", pki_->Operator("viewer", "vera")}};
  }
  static void TearDownTestSuite() {
    delete operator_files_;
    delete server_files_;
    delete pki_;
  }

  void SetUp() override {
    BundleControlFixture::SetUp();
    control_->Start();
    hub_ = std::make_unique<operator_api::StatusBroadcaster>(&store_, nullptr);
    service_ = std::make_unique<operator_api::OperatorService>(
        pipeline_.get(), &store_, hub_.get(),
        operator_api::OperatorService::Access{.watch = &watch_, .bundles = control_.get()});
    const auto credentials = rpc::Credentials::Load(*server_files_);
    ASSERT_THAT(credentials, IsOk());
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*credentials)->ForServer()}, {service_.get()});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
    address_ = server_->address();
    directory_id_ = InUse("r1");
  }
  void TearDown() override {
    server_.reset();
    service_.reset();
    BundleControlFixture::TearDown();
  }

  Result Run(const std::vector<std::string>& args, const std::string& role = "admin") {
    const TlsFiles& files = operator_files_->at(role);
    const std::map<std::string, std::string> env = {{"RIPSCTL_SERVER", address_},
                                                    {"RIPSCTL_CA", files.ca},
                                                    {"RIPSCTL_CERT", files.cert},
                                                    {"RIPSCTL_KEY", files.key},
                                                    {"RIPSCTL_TIMEOUT", "60s"}};
    std::ostringstream out;
    std::ostringstream err;
    const int code =
        RunRipsctl(args, {.out = out,
                          .err = err,
                          .get_env = [&env](const std::string& name) -> std::optional<std::string> {
                            const auto it = env.find(name);
                            if (it == env.end()) return std::nullopt;
                            return it->second;
                          },
                          .connect = ConnectWithTls,
                          .sleep = [this](absl::Duration) { LetASecondPass(); }});
    return Saved(args, {code, out.str(), err.str()});
  }
  nlohmann::json RunJson(std::vector<std::string> args, int expected_code = 0) {
    args.insert(args.end(), {"--output", "json"});
    const Result result = Run(args);
    EXPECT_EQ(result.code, expected_code) << result.err;
    return nlohmann::json::parse(result.out, nullptr, false);
  }
  // Of the server, which looks at its roll-out.
  void LetASecondPass() {
    ++seconds_;
    if (each_second_) each_second_();
    clock_.Advance(kNanosPerSecond);
    Beat();
    OnControl([this] { control_->Look(); });
  }
  // Runs the task on the thread of BundleControl, and returns when it has.
  void OnControl(const std::function<void()>& task) {
    BoundedQueue<int> done{{.capacity = 1}};
    ASSERT_TRUE(control_->thread().Post([&] {
      task();
      done.Push(1);
    }));
    ASSERT_TRUE(done.Pop(kPatience).has_value());
  }
  std::string InUse(const std::string& robot) {
    std::string id;
    OnControl([&] {
      const auto status = control_->Status(robot);
      if (status.ok()) id = status->robots.at(0).bundle_in_use;
    });
    return id;
  }
  // The directory of a bundle for `warehouse` that is another one for each mark.
  std::string Write(const std::string& mark, const std::string& rules = kRules) {
    const std::string dir = dir_.File("mine/" + mark + "/warehouse");
    rollout::WriteBundle(dir, "warehouse", absl::StrCat("# ", mark, "\n", rules));
    return dir;
  }
  // The id of a bundle that was pushed.
  std::string Push(const std::string& mark) {
    const nlohmann::json json = RunJson({"rules", "push", Write(mark)});
    return json["id"];
  }
  size_t Kept() { return RunJson({"rules", "list"})["bundles"].size(); }
  std::unique_ptr<v1::OperatorService::Stub> Stub() {
    const auto credentials = rpc::Credentials::Load(operator_files_->at("admin"));
    EXPECT_THAT(credentials, IsOk());
    return v1::OperatorService::NewStub(rpc::MakeChannel(address_, (*credentials)->ForClient()));
  }

  static rpc::TestPki* pki_;
  static TlsFiles* server_files_;
  static std::map<std::string, TlsFiles>* operator_files_;
  rpc::SessionWatch watch_{&real_clock_};
  std::unique_ptr<operator_api::StatusBroadcaster> hub_;
  std::unique_ptr<operator_api::OperatorService> service_;
  std::unique_ptr<rpc::RpcServer> server_;
  std::string address_;
  // What judges r1 at first.
  std::string directory_id_;
  int seconds_ = 0;
  std::function<void()> each_second_;
};
rpc::TestPki* RulesRolloutTest::pki_ = nullptr;
TlsFiles* RulesRolloutTest::server_files_ = nullptr;
std::map<std::string, TlsFiles>* RulesRolloutTest::operator_files_ = nullptr;

// A push as it goes on.
struct OpenPush {
  explicit OpenPush(v1::OperatorService::StubInterface& stub) {
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kPatience));
    writer = stub.PushBundle(&context, &response);
  }
  bool Send(const std::string& data, size_t archive_bytes) {
    v1::PushBundleRequest piece;
    piece.set_data(data);
    piece.set_archive_bytes(archive_bytes);
    return writer->Write(piece);
  }
  grpc::Status End() {
    writer->WritesDone();
    return writer->Finish();
  }

  grpc::ClientContext context;
  v1::PushBundleResponse response;
  std::unique_ptr<grpc::ClientWriterInterface<v1::PushBundleRequest>> writer;
};

// ---------------------------------------------------------------------------------------- pushing

TEST_F(RulesRolloutTest, APushedBundleIsStoredForNoRobotYet) {
  const std::string dir = Write("fresh");
  const std::string id = bundle::CheckBundle(dir).id;
  const Result pushed = Run({"rules", "push", dir});
  EXPECT_EQ(pushed.code, 0) << pushed.err;
  EXPECT_EQ(pushed.out,
            absl::StrCat("pushed     warehouse\n"
                         "id         ",
                         id,
                         "\n"
                         "signed by  alice\n"
                         "it judges no robot yet; to roll it out: ripsctl rules activate ",
                         id.substr(0, 19), " --all --stage 10% --stage 100% --reason TEXT\n"));
  EXPECT_EQ(InUse("r1"), directory_id_);
  const Result listed = Run({"rules", "list"}, "viewer");
  EXPECT_EQ(listed.code, 0) << listed.err;
  EXPECT_THAT(listed.out, HasSubstr(id.substr(0, 19) + "  warehouse  alice      20"));
  EXPECT_THAT(listed.out, HasSubstr("  4: r1, r2, r3 and 1 more\n"));

  const Result again = Run({"rules", "push", dir});
  EXPECT_EQ(again.code, 0) << again.err;
  EXPECT_THAT(again.out, StartsWith("had already  warehouse\n"));
  const nlohmann::json json = RunJson({"rules", "push", dir});
  EXPECT_EQ(json["id"], id);
  EXPECT_EQ(json["name"], "warehouse");
  EXPECT_EQ(json["signed_by"], "alice");
  EXPECT_EQ(json["known"], true);
  EXPECT_EQ(json["warnings"], "");
  EXPECT_EQ(json["bundle"]["id"], id);
}

TEST_F(RulesRolloutTest, WarningsArePrintedAndHinderNothing) {
  const std::string dir = Write("warned", "");  // there are no rules
  const Result checked = RunOffline({"rules", "check", dir});
  const Result pushed = Run({"rules", "push", dir});
  EXPECT_EQ(pushed.code, checked.code);
  const std::string diagnostics = checked.out.substr(0, checked.out.rfind("ok: "));
  EXPECT_THAT(diagnostics, HasSubstr("warning: "));
  EXPECT_THAT(pushed.out, StartsWith(diagnostics));
}

TEST_F(RulesRolloutTest, ABrokenBundleIsRefusedBeforeAnythingIsSent) {
  const std::string dir =
      Write("broken", "rules Msg:\n  r: nodecout(\"/x\") > 1 ? trigger(HALT);\n");
  const size_t kept = Kept();
  const Result refused = Run({"rules", "push", dir});
  EXPECT_EQ(refused.code, 1);
  EXPECT_EQ(refused.out, RunOffline({"rules", "check", dir}).out);
  EXPECT_THAT(refused.out, HasSubstr("unknown builtin `nodecout`"));
  EXPECT_EQ(refused.err, "error: the bundle is refused; nothing was sent\n");
  const nlohmann::json json = RunJson({"rules", "push", dir}, 1);
  EXPECT_EQ(json["bundle"]["ok"], false);
  EXPECT_TRUE(json["id"].is_null());
  EXPECT_EQ(Run({"rules", "push", dir_.File("none")}).code, 1);
  EXPECT_EQ(Kept(), kept);

  // The server makes the same checks.
  const auto archive = bundle::PackBundle(dir);
  ASSERT_THAT(archive, IsOk());
  const auto stub = Stub();
  OpenPush push(*stub);
  push.Send(*archive, archive->size());
  const grpc::Status end = push.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(end.error_message(), StartsWith("the bundle is refused: "));
  EXPECT_EQ(Kept(), kept);
}

TEST_F(RulesRolloutTest, AServerThatTrustsKeysRefusesWhatNoneOfThemSigned) {
  const bundle::SampleKey key = bundle::MakeEd25519();
  const TestDirectory keys;
  const auto signers = bundle::SignerKeys::Load({keys.Write("carol.pem", key.public_pem)});
  ASSERT_THAT(signers, IsOk());
  OnControl([&] { signers_ = *signers; });
  const std::string dir = Write("fresh");
  const Result refused = Run({"rules", "push", dir});
  EXPECT_EQ(refused.code, 1);
  EXPECT_THAT(refused.err, AllOf(StartsWith("error: refused: "), HasSubstr("ripsctl rules sign")));
  EXPECT_EQ(refused.out, "");

  const std::string key_path = keys.Write("carol.key", key.private_pem);
  std::filesystem::permissions(key_path, std::filesystem::perms::owner_read);
  ASSERT_EQ(RunOffline({"rules", "sign", dir, "--key", key_path}).code, 0);
  const Result pushed = Run({"rules", "push", dir});
  EXPECT_EQ(pushed.code, 0) << pushed.err;
  EXPECT_THAT(pushed.out, HasSubstr("signed by  carol\n"));
  // That of the directory, which was there before.
  EXPECT_THAT(Run({"rules", "list"}).out,
              HasSubstr(directory_id_.substr(0, 19) + " cannot be activated: "));
}

TEST_F(RulesRolloutTest, AThirtyMegabyteBundleIsPushed) {
  const std::string dir = Write("large");
  std::ofstream(dir + "/manifest.yaml", std::ios::app) << "yara: [a.yar, b.yar]\n";
  for (const char* name : {"/a.yar", "/b.yar"}) {
    std::ofstream file(dir + name);
    const std::string line = "// " + std::string(1'000, 'x') + "\n";
    for (size_t bytes = 0; bytes < 15'000'000; bytes += line.size()) file << line;
    file << "rule r { condition: false }\n";
  }
  const Result pushed = Run({"rules", "push", dir});
  EXPECT_EQ(pushed.code, 0) << pushed.err;
  EXPECT_THAT(pushed.out, HasSubstr("pushed     warehouse\n"));
}

TEST_F(RulesRolloutTest, APushThatIsCutOffLeavesNothing) {
  const size_t kept = Kept();
  const auto archive = bundle::PackBundle(Write("fresh"));
  ASSERT_THAT(archive, IsOk());
  const auto stub = Stub();
  {
    OpenPush push(*stub);
    ASSERT_TRUE(push.Send(archive->substr(0, archive->size() / 2), archive->size()));
    push.context.TryCancel();
    EXPECT_EQ(push.writer->Finish().error_code(), grpc::StatusCode::CANCELLED);
  }
  EXPECT_EQ(Kept(), kept);
  for (const auto& entry : std::filesystem::directory_iterator(dir_.File("kept"))) {
    EXPECT_THAT(entry.path().filename().string(), Not(StartsWith(".new")));
  }
  // The server may learn of the end later than its peer.
  const int64_t deadline_ns = BoottimeAfter(kPatience);
  Result next;
  do {
    next = Run({"rules", "push", Write("fresh")});
    ASSERT_LT(BoottimeNow(), deadline_ns) << next.err;
  } while (absl::StrContains(next.err, "another bundle is being pushed"));
  EXPECT_EQ(next.code, 0) << next.err;
  EXPECT_EQ(Kept(), kept + 1);
}

TEST_F(RulesRolloutTest, OneBundleIsPushedAtATimeAndTheNextRightAfterIt) {
  const auto archive = bundle::PackBundle(Write("first"));
  ASSERT_THAT(archive, IsOk());
  const auto stub = Stub();
  OpenPush first(*stub);
  ASSERT_TRUE(first.Send(archive->substr(0, 10), archive->size()));
  // Until the server has the first piece, another one may come before it.
  const int64_t deadline_ns = BoottimeAfter(kPatience);
  Result second;
  do {
    second = Run({"rules", "push", Write("second")});
    ASSERT_LT(BoottimeNow(), deadline_ns);
  } while (second.code == 0);
  EXPECT_EQ(second.code, 1);
  EXPECT_EQ(second.err, "error: another bundle is being pushed; try again later\n");
  ASSERT_TRUE(first.Send(archive->substr(10), archive->size()));
  const grpc::Status end = first.End();
  EXPECT_TRUE(end.ok()) << end.error_message();
  for (int i = 0; i < 20; ++i) {
    const Result next = Run({"rules", "push", Write(absl::StrCat("next", i))});
    EXPECT_EQ(next.code, 0) << next.err;
  }
}

TEST_F(RulesRolloutTest, NoOrderWaitsForABundleThatIsBeingChecked) {
  BoundedQueue<int> checking({.capacity = 1});
  BoundedQueue<int> go({.capacity = 1});
  std::atomic<bool> checked = false;
  on_push_ = [&] {
    checking.Push(1);
    go.Pop(kPatience);
    checked = true;
  };
  Result pushed;
  std::thread push([&] { pushed = Run({"rules", "push", Write("fresh")}); });
  EXPECT_TRUE(checking.Pop(kPatience).has_value());
  const Result stopped = Run({"rules", "stop", "--reason", "x"});
  EXPECT_FALSE(checked);
  EXPECT_THAT(stopped.err, HasSubstr("no roll-out runs"));
  go.Push(1);
  push.join();
  EXPECT_EQ(pushed.code, 0) << pushed.err;
}

TEST_F(RulesRolloutTest, APieceBeyondTheLimitOfItsFieldIsRefused) {
  const auto stub = Stub();
  OpenPush push(*stub);
  push.Send(std::string((1 << 20) + 1, 'x'), 2 << 20);
  const grpc::Status end = push.End();
  EXPECT_FALSE(end.ok());
  EXPECT_THAT(end.error_message(), HasSubstr("data"));
}

// ------------------------------------------------------------------------------------ activating

TEST_F(RulesRolloutTest, AStagedRollOutIsFollowedToItsEnd) {
  const std::string fresh = Push("fresh");
  const Result done =
      Run({"rules", "activate", fresh.substr(0, 15), "--all", "--stage", "ring=canary", "--stage",
           "100%", "--soak", "5s", "--reason", "fewer false alarms", "--wait"});
  EXPECT_EQ(done.code, 0) << done.err;
  EXPECT_THAT(
      done.out,
      StartsWith(absl::StrCat(
          fresh.substr(0, 19),
          " `warehouse` is first to judge r2\n"
          "STAGE  STATE    ROBOTS\n"
          "1      running  r2\n"
          "2      waiting  r1, r3, r4\n"
          "each stage is healthy for 5s; it stops if a level rises, a robot is not "
          "healthy for 10 s (or has not taken the bundle for 30 s), or one has more than 10 "
          "alerts within a minute\n"
          "follow it  ripsctl rules status\n"
          "stop it    ripsctl rules stop --reason TEXT\n"
          "go back    ripsctl rules rollback --all --reason TEXT\n")));
  EXPECT_THAT(done.out, AllOf(HasSubstr("stage 1 of 2 (r2) is healthy; it is done at 2026-01-01T"),
                              HasSubstr("stage 2 of 2 (r1, r3, r4) is "),
                              testing::EndsWith("  done: 2 stages\n")));
  EXPECT_GE(seconds_, 10);
  for (const char* robot : {"r1", "r2", "r3", "r4"}) EXPECT_EQ(InUse(robot), fresh);
  EXPECT_NE(InUse("d1"), fresh);

  const nlohmann::json status = RunJson({"rules", "status", "r1"});
  EXPECT_EQ(status["rollout"]["state"], "done");
  EXPECT_EQ(status["robots"][0]["activated"], fresh);
  EXPECT_THAT(status["robots"][0]["operator"].get<std::string>(),
              StartsWith("alice (spiffe://fleet.example/operator/admin/alice serial "));
  EXPECT_THAT(Run({"rules", "status"}).out,
              HasSubstr(absl::StrCat("\nr1     warehouse  ", fresh.substr(0, 19), "  ",
                                     fresh.substr(0, 19), "  alice  2026-01-01T00:0")));
  EXPECT_EQ(status["robots"][0]["reason"], "fewer false alarms");
  EXPECT_EQ(status["robots"][0]["before"], "directory");
  EXPECT_EQ(RunJson({"rules", "list"})["bundles"][0]["robots"],
            nlohmann::json({"r1", "r2", "r3", "r4"}));

  const Result again =
      Run({"rules", "activate", fresh, "--robot", "r1", "--reason", "x", "--wait"});
  EXPECT_EQ(again.code, 0);
  EXPECT_EQ(again.out, "nothing changes\nleft out  r1: is to be judged by it already\n");
  const nlohmann::json directory = RunJson({"rules", "activate", "directory", "--robot", "r1",
                                            "--reason", "x", "--soak", "1s", "--wait"});
  EXPECT_EQ(directory["rollout"]["from_directory"], true);
  EXPECT_EQ(InUse("r1"), directory_id_);
}

TEST_F(RulesRolloutTest, AnOperatorStopsARollOutThatAnotherOneFollows) {
  const std::string fresh = Push("fresh");
  EXPECT_THAT(Run({"rules", "stop", "--reason", "x"}).err, HasSubstr("no roll-out runs"));
  Result stop;
  each_second_ = [&] {
    if (seconds_ == 3) stop = Run({"rules", "stop", "--reason", "lunch"});
  };
  const Result followed = Run({"rules", "activate", fresh, "--all", "--stage", "50%", "--stage",
                               "100%", "--reason", "new rules", "--wait"});
  EXPECT_EQ(followed.code, 1);
  EXPECT_THAT(followed.out, HasSubstr("  stopped in stage 1 of 2 (r1, r2): alice: lunch\n"));
  EXPECT_EQ(stop.code, 0) << stop.err;
  EXPECT_THAT(stop.out, HasSubstr("state     stopped in stage 1 of 2 (r1, r2): alice: lunch; at "));
  EXPECT_EQ(InUse("r1"), fresh) << "robots stay as they are";
  EXPECT_EQ(InUse("r3"), directory_id_);
  EXPECT_EQ(RunJson({"rules", "status"})["rollout"]["state"], "stopped");

  const Result back = Run({"rules", "rollback", "--all", "--reason", "it was wrong"});
  EXPECT_EQ(back.code, 0) << back.err;
  EXPECT_THAT(back.out, AllOf(StartsWith("judged as before from now on: r1, r2\n"),
                              HasSubstr("left out  r3: has nothing to go back to\n")));
  EXPECT_EQ(InUse("r1"), directory_id_);
  const Result twice = Run({"rules", "rollback", "--all", "--reason", "x"});
  EXPECT_EQ(twice.code, 1);
  EXPECT_THAT(twice.out, StartsWith("nothing changes: no robot has anything to go back to\n"));
}

TEST_F(RulesRolloutTest, StopPrintsTheRollOutAsJson) {
  const std::string fresh = Push("fresh");
  ASSERT_EQ(Run({"rules", "activate", fresh, "--all", "--reason", "x"}).code, 0);
  EXPECT_EQ(RunJson({"rules", "stop", "--reason", "lunch"})["rollout"]["state"], "stopped");
}

TEST_F(RulesRolloutTest, ARollOutThatDoesHarmStopsAndGoesBack) {
  const std::string fresh = Push("fresh");
  each_second_ = [&] {
    if (seconds_ != 2) return;
    for (int i = 0; i < 4; ++i) {
      rates_->OnAlert({.robot = "r2", .rule = "spy", .severity = "high", .text = "who reads?"});
    }
  };
  const nlohmann::json json =
      RunJson({"rules", "activate", fresh, "--label", "ring=canary", "--alerts-max", "3",
               "--rollback", "--reason", "new rules", "--wait"},
              1);
  EXPECT_EQ(json["rollout"]["state"], "stopped");
  EXPECT_THAT(json["rollout"]["why"].get<std::string>(), StartsWith("r2: its rules raised 4"));
  EXPECT_EQ(json["changed"], nlohmann::json({"r2"}));
  EXPECT_EQ(InUse("r2"), directory_id_);
}

TEST_F(RulesRolloutTest, ARollBackStopsTheRollOutOfItsRobots) {
  const std::string fresh = Push("fresh");
  ASSERT_EQ(Run({"rules", "activate", fresh, "--all", "--reason", "x"}).code, 0);
  const Result second = Run({"rules", "activate", fresh, "--all", "--reason", "x"});
  EXPECT_EQ(second.code, 1);
  EXPECT_THAT(second.err, HasSubstr("wait for its end, or end it with `ripsctl rules stop`"));
  const Result dry = Run({"rules", "rollback", "--robot", "r1", "--reason", "x", "--dry-run"});
  EXPECT_EQ(dry.code, 0);
  EXPECT_THAT(dry.out, AllOf(StartsWith("nothing was changed; would be judged as before: r1\n"),
                             HasSubstr(" -> what the directory holds\n")));
  EXPECT_EQ(
      RunJson({"rules", "rollback", "--robot", "r1", "--reason", "x", "--dry-run"})["changed"],
      nlohmann::json({"r1"}));
  EXPECT_EQ(InUse("r1"), fresh);
  const Result back = Run({"rules", "rollback", "--robot", "r1", "--reason", "x"});
  EXPECT_EQ(back.code, 0);
  EXPECT_THAT(back.out, HasSubstr("stopped in stage 1 of 1 (r1, r2, r3, r4): alice rolled back"));
  EXPECT_EQ(InUse("r1"), directory_id_);
  EXPECT_EQ(InUse("r2"), fresh);
}

TEST_F(RulesRolloutTest, AShadowRunsBesideWhatJudgesUntilItEnds) {
  const std::string fresh = Push("fresh");
  const Result began =
      Run({"rules", "shadow", fresh, "--label", "ring=canary", "--reason", "to see"}, "operator");
  EXPECT_EQ(began.code, 0) << began.err;
  EXPECT_THAT(began.out, StartsWith("runs muted on: r2\n"));
  EXPECT_EQ(InUse("r2"), directory_id_);
  const Result shown = Run({"rules", "status", "r2"}, "viewer");
  EXPECT_EQ(shown.code, 0) << shown.out;
  EXPECT_THAT(shown.out, HasSubstr(absl::StrCat("shadow        ", fresh, " `warehouse`\n")));
  EXPECT_EQ(RunJson({"rules", "status", "r2"})["robots"][0]["shadow"]["bundle"], fresh);
  EXPECT_TRUE(RunJson({"rules", "status", "r1"})["robots"][0]["shadow"].is_null());
  const Result viewer = Run({"rules", "shadow", fresh, "--all", "--reason", "to see"}, "viewer");
  EXPECT_EQ(viewer.code, 1);
  EXPECT_THAT(viewer.err, HasSubstr("needs the role `operator`"));
  const Result unknown = Run({"rules", "shadow", "0123456789", "--all", "--reason", "to see"});
  EXPECT_EQ(unknown.code, 1);
  EXPECT_THAT(unknown.err, HasSubstr("keeps no bundle 0123456789"));
  const Result ended = Run({"rules", "shadow", "--end", "--robot", "r1", "r2", "--reason", "seen"});
  EXPECT_EQ(ended.code, 0) << ended.err;
  EXPECT_EQ(ended.out, "no shadow any more: r2\nleft out  r1: has no shadow\n");
  EXPECT_TRUE(RunJson({"rules", "status", "r2"})["robots"][0]["shadow"].is_null());
}

TEST_F(RulesRolloutTest, ADryRunChangesNothing) {
  const std::string fresh = Push("fresh");
  const Result dry = Run({"rules", "activate", fresh, "--all", "--stage", "25%", "--stage", "100%",
                          "--reason", "x", "--dry-run"});
  EXPECT_EQ(dry.code, 0) << dry.err;
  EXPECT_THAT(dry.out,
              AllOf(StartsWith("nothing was changed; it would be: "),
                    HasSubstr(" would first judge r1\n"), HasSubstr("2      waiting  r2, r3, r4")));
  EXPECT_EQ(InUse("r1"), directory_id_);
  EXPECT_THAT(Run({"rules", "status"}).out, StartsWith("no bundle was rolled out yet\n"));
}

TEST_F(RulesRolloutTest, MisspeltNamesAreSaid) {
  const std::string fresh = Push("fresh");
  const struct {
    std::vector<std::string> args;
    const char* why;
  } cases[] = {
      {{"rules", "activate", fresh, "--robot", "r9"}, "robot `r9` is not in the inventory"},
      {{"rules", "activate", fresh, "--robot", "d1"}, "the bundle is of policy `warehouse`"},
      {{"rules", "activate", fresh, "--label", "ring=canry"}, "no robot with policy `warehouse`"},
      {{"rules", "activate", "0123456789ab", "--all"}, "keeps no bundle 0123456789ab"},
      {{"rules", "activate", "directory", "--robot", "r1", "d1"}, "choose robots of one policy"},
      {{"rules", "activate", fresh, "--all", "--stage", "ring=canary"}, "end them with 100%"},
      {{"rules", "rollback", "--robot", "r9"}, "robot `r9` is not in the inventory"},
      {{"rules", "rollback", "--label", "a=b"}, "the inventory has no robot with a=b"},
  };
  for (const auto& each : cases) {
    std::vector<std::string> args = each.args;
    args.insert(args.end(), {"--reason", "x"});
    const Result result = Run(args);
    EXPECT_EQ(result.code, 1) << each.why;
    EXPECT_THAT(result.err, HasSubstr(each.why));
    EXPECT_EQ(result.out, "");
  }
  EXPECT_THAT(Run({"rules", "status", "r9"}).err,
              HasSubstr("error: robot `r9` is not in the inventory"));
}

TEST_F(RulesRolloutTest, AHeldRobotStandsFirstWithItsProblem) {
  std::ofstream(dir_.File("robots.yaml"), std::ios::app)
      << "  - {id: z1, bundle: hall, sensors: [{host: base, primary: true}]}\n";
  ASSERT_TRUE(control_->Reload([] {}));
  const Result result = Run({"rules", "status"}, "viewer");
  EXPECT_EQ(result.code, 1);
  const size_t held = result.out.find("\nz1     hall       -   ");
  ASSERT_NE(held, std::string::npos) << result.out;
  EXPECT_LT(held, result.out.find("\nd1     dock"));
  EXPECT_THAT(result.out, HasSubstr("-\n  no policy: "));
  const Result one = Run({"rules", "status", "z1"});
  EXPECT_EQ(one.code, 1);
  EXPECT_THAT(one.out, HasSubstr("problem       no policy: "));
  EXPECT_EQ(Run({"rules", "status", "r1"}).code, 0);
}

// -------------------------------------------------------------------------------------- refusals

TEST_F(RulesRolloutTest, OnlyAnAdministratorChangesWhatJudgesRobots) {
  const std::string dir = Write("fresh");
  const std::string id = bundle::CheckBundle(dir).id;
  for (const char* role : {"viewer", "operator"}) {
    const std::vector<std::vector<std::string>> refused = {
        {"rules", "push", dir},
        {"rules", "activate", id, "--all", "--reason", "x"},
        {"rules", "rollback", "--all", "--reason", "x"},
        {"rules", "stop", "--reason", "x"}};
    for (const std::vector<std::string>& args : refused) {
      const Result result = Run(args, role);
      EXPECT_EQ(result.code, 1) << role << " " << args[1];
      EXPECT_THAT(result.err,
                  AllOf(StartsWith("error: refused: "), HasSubstr("needs the role `admin`")));
    }
    EXPECT_EQ(Run({"rules", "list"}, role).code, 0);
    EXPECT_EQ(Run({"rules", "status"}, role).code, 0);
  }
  EXPECT_EQ(Run({"rules", "push", dir}).code, 0);
}

TEST_F(RulesRolloutTest, AServerThatIsAwayIsExitCodeThree) {
  server_->Shutdown(absl::ZeroDuration());
  const std::vector<std::vector<std::string>> all = {
      {"rules", "push", Write("fresh")},
      {"rules", "list"},
      {"rules", "status"},
      {"rules", "activate", "directory", "--all", "--reason", "x", "--wait"},
      {"rules", "rollback", "--all", "--reason", "x"},
      {"rules", "stop", "--reason", "x"},
      {"rules", "shadow", "--end", "--all", "--reason", "x"}};
  for (const std::vector<std::string>& args : all) {
    const Result result = Run(args);
    EXPECT_EQ(result.code, 3) << args[1];
    EXPECT_THAT(result.err, StartsWith("error: cannot reach the policy server: ")) << args[1];
  }
}

}  // namespace
}  // namespace rips::ripsctl
