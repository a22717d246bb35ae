// What a server sends does not steer the operator's terminal: each text of each answer and each
// error, through every verb, as text and as JSON. A server that goes on for ever fills no disk.
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/message.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/support/client_interceptor.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/cli/text_stream.h"
#include "policy_server/ripsctl/every_verb.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"
#include "policy_server/ripsctl/top/fleet_view.h"
#include "services/runtime/mutex.h"
#include "services/text/escape.h"

namespace rips::ripsctl {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::StartsWith;

// A title, a bell, a line of its own, a turned direction of writing, a C1 control.
constexpr char kMark[] = "<\x1b]0;x\x07\t\r\n\xe2\x80\xae\xc2\x85\x7f>";
// A line that begins so was begun by a line end of the server.
constexpr char kAfterLineEnd[] = "\\u202e";
constexpr int kDepthMax = 8;

// Makes answers of an honest server hostile. Safe from any thread.
class Spoiler {
 public:
  // 0: every text is hostile. Otherwise some, by the names of fields, so that the others let a
  // command go on; numbers and flags are changed as well.
  void set_seed(uint64_t seed) { seed_ = seed; }
  void Spoil(Message& message, int depth = 0) {
    const auto& parts = *message.GetReflection();
    for (int i = 0; i < message.GetDescriptor()->field_count(); ++i) {
      const FieldDescriptor* const field = message.GetDescriptor()->field(i);
      if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE && depth == kDepthMax) continue;
      // Members of a oneof exclude each other: what is set stays.
      const bool excluded = field->real_containing_oneof() != nullptr && !IsSet(message, field) &&
                            parts.HasOneof(message, field->real_containing_oneof());
      if (excluded && !Chosen(field, 1)) continue;
      if (!field->is_repeated()) {
        SpoilOne(message, field, depth);
        continue;
      }
      if (parts.FieldSize(message, field) == 0 && Chosen(field, 2)) Add(message, field);
      for (int j = 0; j < parts.FieldSize(message, field); ++j) {
        if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
          Spoil(*parts.MutableRepeatedMessage(&message, field, j), depth + 1);
        } else if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING && Chosen(field, 0)) {
          parts.SetRepeatedString(&message, field, j, Hostile(field));
        }
      }
    }
  }
  std::set<std::string> spoilt() ABSL_LOCKS_EXCLUDED(mutex_) {
    const MutexLock lock(&mutex_);
    return spoilt_;
  }

 private:
  static bool IsSet(const Message& message, const FieldDescriptor* field) {
    const auto& parts = *message.GetReflection();
    return field->is_repeated() ? parts.FieldSize(message, field) > 0
                                : parts.HasField(message, field);
  }
  // Another for each `use` of a field.
  bool Chosen(const FieldDescriptor* field, uint64_t use) const {
    if (seed_ == 0) return true;
    uint64_t hash = 14695981039346656037u ^ (seed_ * 8 + use);  // FNV-1a
    for (const char c : field->full_name()) {
      hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211u;
    }
    return (hash >> 32) % 2 == 0;
  }
  std::string Hostile(const FieldDescriptor* field) ABSL_LOCKS_EXCLUDED(mutex_) {
    const MutexLock lock(&mutex_);
    spoilt_.insert(field->full_name());
    return field->type() == FieldDescriptor::TYPE_BYTES ? absl::StrCat(kMark, "\x9b\xff") : kMark;
  }
  void SpoilOne(Message& message, const FieldDescriptor* field, int depth) {
    const auto& parts = *message.GetReflection();
    const bool numbers = seed_ != 0 && Chosen(field, 3);
    switch (field->cpp_type()) {
      case FieldDescriptor::CPPTYPE_MESSAGE:
        if (IsSet(message, field) || Chosen(field, 2)) {
          Spoil(*parts.MutableMessage(&message, field), depth + 1);
        }
        break;
      case FieldDescriptor::CPPTYPE_STRING:
        if (Chosen(field, 0)) parts.SetString(&message, field, Hostile(field));
        break;
      case FieldDescriptor::CPPTYPE_BOOL:
        if (numbers) parts.SetBool(&message, field, !parts.GetBool(message, field));
        break;
      case FieldDescriptor::CPPTYPE_ENUM:
        if (numbers) parts.SetEnumValue(&message, field, static_cast<int>(seed_ % 7));
        break;
      case FieldDescriptor::CPPTYPE_UINT32:
        if (numbers) parts.SetUInt32(&message, field, static_cast<uint32_t>(seed_));
        break;
      case FieldDescriptor::CPPTYPE_UINT64:
        if (numbers) parts.SetUInt64(&message, field, seed_);
        break;
      default:
        break;
    }
  }
  static void Add(Message& message, const FieldDescriptor* field) {
    const auto& parts = *message.GetReflection();
    switch (field->cpp_type()) {
      case FieldDescriptor::CPPTYPE_MESSAGE:
        parts.AddMessage(&message, field);
        break;
      case FieldDescriptor::CPPTYPE_STRING:
        parts.AddString(&message, field, "x");
        break;
      default:
        break;
    }
  }

  uint64_t seed_ = 0;
  Mutex mutex_;
  std::set<std::string> spoilt_ ABSL_GUARDED_BY(mutex_);
};

// The texts of `type` and of what is in it.
void CollectTexts(const Descriptor* type, std::set<const Descriptor*>& seen,
                  std::set<std::string>& texts) {
  if (!seen.insert(type).second) return;
  for (int i = 0; i < type->field_count(); ++i) {
    const FieldDescriptor* const field = type->field(i);
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING) texts.insert(field->full_name());
    if (field->message_type() != nullptr) CollectTexts(field->message_type(), seen, texts);
  }
}

// On the side of the client, where an answer and a status have come.
class HostileAnswers final : public grpc::experimental::Interceptor {
 public:
  HostileAnswers(Spoiler* spoiler, std::string error)
      : spoiler_(spoiler), error_(std::move(error)) {}
  void Intercept(grpc::experimental::InterceptorBatchMethods* methods) override {
    using Point = grpc::experimental::InterceptionHookPoints;
    if (methods->QueryInterceptionHookPoint(Point::POST_RECV_MESSAGE) &&
        methods->GetRecvMessage() != nullptr) {
      spoiler_->Spoil(*static_cast<Message*>(
          static_cast<google::protobuf::MessageLite*>(methods->GetRecvMessage())));
    }
    if (methods->QueryInterceptionHookPoint(Point::POST_RECV_STATUS) && !error_.empty()) {
      grpc::Status* const status = methods->GetRecvStatus();
      if (!status->ok()) *status = grpc::Status(status->error_code(), error_);
    }
    methods->Proceed();
  }

 private:
  Spoiler* const spoiler_;
  const std::string error_;
};

class HostileServerTest : public RipsctlTest {
 protected:
  HostileServerTest() {
    fake_.receipts.add_receipts()->set_host("base");
    fake_.configuration.add_agents()->set_host("base");
    fake_.pending.emplace_back().set_id("333333aa");
    fake_.explained["r1@3.17"] = MakeFindingExplained();
    *fake_.explained["r1@3.17"].mutable_evidence() = MakeEvidence();
    fake_.coverage = MakeFindings(3);
    fake_.rollout.mutable_rollout()->set_state("done");
    fake_.rules_states.emplace_back().mutable_rollout()->set_state("done");
  }
  // Makes an interceptor for each call, and notes its name.
  struct Hostility final : grpc::experimental::ClientInterceptorFactoryInterface {
    explicit Hostility(HostileServerTest* the_test) : test(the_test) {}
    grpc::experimental::Interceptor* CreateClientInterceptor(
        grpc::experimental::ClientRpcInfo* info) override {
      const std::string name = info->method();  // `/rips.v1.OperatorService/ListRobots`
      test->called_.insert(name.substr(name.rfind('/') + 1));
      return new HostileAnswers(&test->spoiler_, test->error_);
    }
    HostileServerTest* const test;
  };

  Result RunHostile(const Args& args) {
    std::ostringstream out;
    std::ostringstream err;
    const int code =
        RunRipsctl(args, {.out = out,
                          .err = err,
                          .get_env = [this](const std::string& name) -> std::optional<std::string> {
                            if (name == "HOME") return home_;
                            return std::nullopt;
                          },
                          .connect = [this](const RawSettings&) { return ConnectHostile(); },
                          .sleep = [](absl::Duration) {}});
    return {code, out.str(), err.str()};
  }
  absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> ConnectHostile() {
    if (channel_ == nullptr) {
      std::vector<std::unique_ptr<grpc::experimental::ClientInterceptorFactoryInterface>> creators;
      creators.push_back(std::make_unique<Hostility>(this));
      channel_ = grpc::experimental::CreateCustomChannelWithInterceptors(
          absl::StrCat("127.0.0.1:", port_), grpc::InsecureChannelCredentials(), {},
          std::move(creators));
    }
    return std::unique_ptr<v1::OperatorService::StubInterface>(
        v1::OperatorService::NewStub(channel_));
  }
  void ExpectHarmless(const Args& args) {
    const std::string where =
        absl::StrCat(absl::StrJoin(args, " "), ", seed ", seed_, error_.empty() ? "" : ", error");
    const Result text = RunHostile(args);
    ExpectHarmlessText(text.out, where);
    ExpectHarmlessText(text.err, where);
    Args as_json = args;
    as_json.insert(as_json.end(), {"--output", "json"});
    const Result json = RunHostile(as_json);
    ExpectHarmlessText(json.err, where + ", JSON");
    for (const absl::string_view line : absl::StrSplit(json.out, '\n', absl::SkipEmpty())) {
      EXPECT_TRUE(nlohmann::json::accept(line)) << where << ": " << EscapeText(line);
      for (const char c : line) {
        if (c >= ' ' && c <= '~') continue;
        ADD_FAILURE() << where << ": " << EscapeText(line);
        break;
      }
    }
  }
  static void ExpectHarmlessText(absl::string_view text, const std::string& where) {
    for (const absl::string_view line : absl::StrSplit(text, '\n')) {
      EXPECT_EQ(EscapeText(line), line) << where;
      EXPECT_FALSE(absl::StartsWith(line, kAfterLineEnd)) << where << ": " << text;
    }
  }

  Spoiler spoiler_;
  std::shared_ptr<grpc::Channel> channel_;
  uint64_t seed_ = 0;
  std::string error_;
  std::set<std::string> called_;
};

TEST_F(HostileServerTest, NoTextOfAnAnswerSteersTheTerminal) {
  constexpr uint64_t kSeeds = 6;
  std::set<std::string> texts;
  std::set<const Descriptor*> seen;
  std::set<std::string> methods;
  const google::protobuf::ServiceDescriptor* const service =
      google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(
          "rips.v1.OperatorService");
  ASSERT_NE(service, nullptr);
  for (int i = 0; i < service->method_count(); ++i) {
    methods.insert(service->method(i)->name());
    CollectTexts(service->method(i)->output_type(), seen, texts);
  }
  const std::vector<Args> all = ServerVerbs(directory_);
  for (seed_ = 0; seed_ < kSeeds; ++seed_) {
    spoiler_.set_seed(seed_);
    for (const Args& args : all) ExpectHarmless(args);
  }
  EXPECT_EQ(called_, methods) << "each answer is printed by a verb of every_verb.h";
  for (const std::string& spoilt : spoiler_.spoilt()) texts.erase(spoilt);
  EXPECT_EQ(texts, std::set<std::string>()) << "each of its texts was hostile once";
}

TEST_F(HostileServerTest, NoErrorTextSteersTheTerminal) {
  error_ = kMark;
  for (const grpc::StatusCode code :
       {grpc::StatusCode::UNAVAILABLE, grpc::StatusCode::PERMISSION_DENIED,
        grpc::StatusCode::UNIMPLEMENTED, grpc::StatusCode::INTERNAL}) {
    fake_.failure = fake_.explain_failure = grpc::Status(code, "x");
    fake_.alert_watches = {{.end = fake_.failure}};  // before an alert, or the watch goes on
    for (const Args& args : ServerVerbs(directory_)) ExpectHarmless(args);
  }
}

TEST_F(HostileServerTest, NoStatusSteersTheScreenOfTop) {
  FleetView view(kMark);
  view.Connected();
  v1::RobotStatus status = MakeStatus("r1", "HALT");
  for (spoiler_.set_seed(0); const char* robot : {"r1", "r2"}) {
    status.set_robot(robot);
    spoiler_.Spoil(status);
    view.Update(status);
  }
  view.Lost(kMark, absl::Now());
  for (const ScreenLine& line : view.Render({}, absl::Now())) {
    EXPECT_EQ(EscapeText(line.text), line.text);
  }
}

TEST(TextStreamTest, EscapesWhatIsNotWrittenInTheSource) {
  std::ostringstream text;
  const TextStream out(text);
  const std::string mark = kMark;
  out << "a\n" << mark << "\n" << absl::string_view(mark) << "\n" << 7 << true << "\n";
  const std::string escaped = "<\\x1b]0;x\\x07\\x09\\x0d\\x0a\\u202e\\u0085\\x7f>";
  EXPECT_EQ(text.str(), absl::StrCat("a\n", escaped, "\n", escaped, "\n71\n"));
  text.str("");
  out << Lines{"a\tb\x1b\n\nc\r\n"};
  EXPECT_EQ(text.str(), "a\tb\\x1b\n\nc\\x0d\n");
  text.str("");
  out.Raw(mark);
  EXPECT_EQ(text.str(), mark);
}

TEST(CommandLineTest, NoArgumentSteersTheTerminal) {
  for (const Args& args : std::vector<Args>{{kMark},
                                            {"robot", kMark},
                                            {"robot", "show", kMark},
                                            {"robot", "list", kMark},
                                            {"robot", "list", "--output", kMark},
                                            {"rules", "check", kMark},
                                            {"rules", "fmt", kMark},
                                            {"audit", "export", kMark},
                                            {"--context", kMark, "robot", "list"}}) {
    const Result result = RunOffline(args);
    EXPECT_NE(result.code, 0);
    for (const absl::string_view line :
         absl::StrSplit(absl::StrReplaceAll(result.out + result.err, {{"\t", " "}}), '\n')) {
      EXPECT_EQ(EscapeText(line), line);
    }
  }
}

// Its recordings do not end, and their header promises little.
class EndlessRecorder final : public v1::OperatorService::Service {
 public:
  uint64_t file_bytes = 1;

  grpc::Status Record(grpc::ServerContext* context, const v1::RecordRequest*,
                      grpc::ServerWriter<v1::Recording>* writer) override {
    v1::Recording piece;
    piece.mutable_header()->set_robot("r1");
    writer->Write(piece);
    piece.mutable_event()->set_time_unix_ns(kNewYear);
    piece.mutable_event()->mutable_signal()->set_name("SIGUSR1");
    while (!context->IsCancelled() && writer->Write(piece)) {
    }
    return grpc::Status::OK;
  }
  grpc::Status GetAlertRecording(grpc::ServerContext* context, const v1::GetAlertRecordingRequest*,
                                 grpc::ServerWriter<v1::FilePiece>* writer) override {
    v1::FilePiece piece;
    piece.set_data(std::string(10'000, 'x'));
    piece.set_file_bytes(file_bytes);
    while (!context->IsCancelled() && writer->Write(piece)) {
    }
    return grpc::Status::OK;
  }
};

class EndlessServerTest : public RipsctlTest {
 protected:
  EndlessServerTest() {
    server_->Shutdown();
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(&endless_);
    server_ = builder.BuildAndStart();
  }

  EndlessRecorder endless_;
  const std::string path_ = home_ + "/r1.rips";
};

TEST_F(EndlessServerTest, ARecordingEndsAtTheLimitWithWholeEvents) {
  const Result result = Run({"record", "r1", "--out", path_, "--max-bytes", "100000"});
  EXPECT_EQ(result.code, 1);
  EXPECT_THAT(result.err, HasSubstr("exceeds --max-bytes 100000; `" + path_ + "` holds the "));
  EXPECT_LE(std::filesystem::file_size(path_), 100'000u);
  EXPECT_GT(std::filesystem::file_size(path_), 99'000u);
  const std::string rules = File("r.rul", "levels: A;\n");
  EXPECT_EQ(Run({"rules", "replay", "--rules", rules, "--events", path_}).code, 0);
}

TEST_F(EndlessServerTest, TheRecordingOfAnAlertIsRefusedAtTheLimit) {
  File("r1.rips", "an earlier one");
  const Args args = {"alert", "recording", "1", "--out", path_, "--force", "--max-bytes", "100000"};
  for (const uint64_t promised : {uint64_t{1}, uint64_t{1} << 40}) {
    endless_.file_bytes = promised;
    const Result result = Run(args);
    EXPECT_EQ(result.code, 1);
    EXPECT_EQ(result.err, "error: the recording exceeds --max-bytes 100000\n");
  }
  EXPECT_EQ(std::filesystem::file_size(path_), 14u) << "what was there stays";
  EXPECT_FALSE(std::filesystem::exists(path_ + ".part"));
  endless_.file_bytes = (uint64_t{4} << 30) + 1;
  EXPECT_THAT(Run({"alert", "recording", "1", "--out", home_ + "/b.rips"}).err,
              HasSubstr("exceeds --max-bytes 4294967296"));
  EXPECT_FALSE(std::filesystem::exists(home_ + "/b.rips"));
}

}  // namespace
}  // namespace rips::ripsctl
