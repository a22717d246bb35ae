// Certificates that a program signs: real processes, shell scripts with openssl.
#include "policy_server/server/enrol/external_ca.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/enrol/enrolment.h"
#include "policy_server/server/store/sqlite_enrolments.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/pki/key_request.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/unique_fd.h"

namespace rips::enrol {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;

constexpr char kSensorName[] = "spiffe://fleet.example/robot/r1/sensor/base";
constexpr char kAdminName[] = "spiffe://fleet.example/operator/admin/root serial 1f";
// Signs standard input under @; EXT and MORE are replaced.
constexpr char kSign[] = R"(cd @; cat > csr.$$
printf 'keyUsage=digitalSignature\nextendedKeyUsage=clientAuth\nsubjectAltName=URI:'$RIPS_IDENTITY'EXT' > ext.$$
MORE openssl x509 -req -in csr.$$ -CA ca/issuing.pem -CAkey ca/issuing.key -days DAYS \
  -set_serial 0x$(openssl rand -hex 15) -extfile ext.$$ 2>/dev/null && cat ca/issuing.pem
)";

class ExternalCaTest : public ::testing::Test {
 protected:
  ExternalCaTest() {
    clock_.JumpUnix(absl::ToUnixNanos(absl::Now()) - clock_.Now().unix_ns);
    store_ = *store::SqliteEnrolments::Open(pki_.dir() + "/enrolment.db");
  }
  ~ExternalCaTest() override {
    EXPECT_TRUE(waitpid(-1, nullptr, WNOHANG) == -1 && errno == ECHILD) << "a child is left";
  }
  std::string Path(const std::string& name) { return absl::StrCat(pki_.dir(), "/", name); }
  // The program that signs from now on; `@` in it is the directory.
  void Program(const std::string& body) {
    const std::string text =
        absl::StrCat("#!/bin/sh\n", absl::StrReplaceAll(body, {{"@", pki_.dir()}}));
    ASSERT_THAT(WriteFileAtomically(Path("sign"), text, 0755), IsOk());
    ASSERT_EQ(chmod(Path("sign").c_str(), 0755), 0);
  }
  static std::string Signing(const std::string& extensions = "", const std::string& days = "1",
                             const std::string& more = "") {
    return absl::StrReplaceAll(kSign, {{"EXT", extensions}, {"DAYS", days}, {"MORE", more}});
  }
  Enrolment& enrolment(std::vector<std::string> program = {},
                       absl::Duration timeout = absl::Seconds(60)) {
    if (program.empty()) program = {Path("sign")};
    ca_.emplace(
        ExternalCaOptions{
            .program = std::move(program),
            .timeout = timeout,
            .failed = [this](absl::string_view reason) { failures_.emplace_back(reason); }},
        &clock_);
    enrolment_ = std::make_unique<Enrolment>(
        EnrolmentOptions{.files = {.ca = Path("ca.pem")},
                         .external_ca = &*ca_,
                         .trust_domain = "fleet.example",
                         .life = absl::Hours(24)},
        store_.get(), &clock_,
        EnrolmentPorts{.is_banned = [this](const auto&, const auto&) { return banned_; },
                       .tell =
                           [this](const std::string& robot, engine::Severity severity,
                                  const std::string& text) {
                             alerts_.push_back(
                                 absl::StrCat(robot, " ", engine::ToString(severity), " ", text));
                           },
                       .issued = [](const auto&) {}});
    enrolment_->SetInventory(
        {.robots = {
             {.id = "r1", .bundle = "b", .sensors = {{.host = "base"}}, .actuators = {"base"}}}});
    return *enrolment_;
  }
  absl::StatusOr<NewToken> Token() {
    return enrolment_->CreateToken({.robot = "r1",
                                    .host = "base",
                                    .request_pem = *pki::RequestFor(*pki::NewKey()),
                                    .by = kAdminName});
  }
  absl::StatusOr<Fetched> Enrol(const NewToken& token, const std::string& key,
                                const std::string& role = "sensor") {
    clock_.Advance(absl::ToInt64Nanoseconds(kBetweenFetches));
    return enrolment_->Enrol(rpc::ReadLeaf(token.fetched.certificates_pem)->identity, role,
                             *pki::RequestFor(key));
  }
  absl::StatusOr<Fetched> Renew() {
    clock_.Advance(absl::ToInt64Nanoseconds(kBetweenRenewals));
    return enrolment_->Renew(*rpc::ParseSpiffeUri(kSensorName), *pki::RequestFor(*pki::NewKey()));
  }
  // A renewal that fails as counted by `reason`; nothing is recorded. Returns why.
  std::string Failure(const std::string& reason, absl::StatusCode code) {
    failures_.clear();
    alerts_.clear();
    const auto renewed = Renew();
    EXPECT_THAT(failures_, ElementsAre(reason));
    EXPECT_EQ(renewed.status().code(), code) << renewed.status();
    EXPECT_THAT(*store_->ListIssued(""), IsEmpty());
    return std::string(renewed.status().message());
  }

  rpc::TestPki pki_;
  FakeClock clock_;
  std::unique_ptr<store::SqliteEnrolments> store_;
  std::optional<ExternalCa> ca_;
  std::unique_ptr<Enrolment> enrolment_;
  std::vector<std::string> failures_;
  std::vector<std::string> alerts_;
  bool banned_ = false;
};

TEST_F(ExternalCaTest, ATokenFetchesAndAnAgentRenewsWhatTheProgramSigns) {
  Program(Signing());
  enrolment();
  const auto token = Token();
  ASSERT_THAT(token, IsOk());
  EXPECT_EQ(token->record.expires_unix_ns,
            token->record.time_unix_ns + absl::ToInt64Nanoseconds(kTokenLifeDefault))
      << "its certificate is good for a day";
  const std::string key = *pki::NewKey();
  const auto fetched = Enrol(*token, key);
  ASSERT_THAT(fetched, IsOk());
  EXPECT_THAT(rpc::CheckChain(fetched->authorities_pem, fetched->certificates_pem, key), IsOk());
  const auto leaf = rpc::ReadLeaf(fetched->certificates_pem);
  EXPECT_EQ(rpc::ToString(leaf->identity), kSensorName);
  EXPECT_EQ(leaf->serial, fetched->record.serial);
  EXPECT_EQ(Enrol(*token, key)->certificates_pem, fetched->certificates_pem) << "not signed anew";
  EXPECT_THAT(Enrol(*token, *pki::NewKey()), StatusIs(absl::StatusCode::kFailedPrecondition));
  ASSERT_THAT(Renew(), IsOk());
  EXPECT_THAT(*store_->ListIssued(kSensorName), SizeIs(2));
  EXPECT_THAT(failures_, IsEmpty());
}

TEST_F(ExternalCaTest, TheProgramHasTheRequestAndTheNamesAndNothingElse) {
  ASSERT_EQ(setenv("RIPS_TEST_SECRET", "x", 1), 0);
  Program("tr '\\0' '\\n' < /proc/$$/environ > @/environment; cat > @/input; echo \"$*\" > @/args");
  enrolment({Path("sign"), "--ca", "a b"});
  const std::string request = *pki::RequestFor(*pki::NewKey());
  EXPECT_THAT(enrolment_->Renew(*rpc::ParseSpiffeUri(kSensorName), request),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("no certificate in it")));
  EXPECT_EQ(*ReadFile(Path("input"), 1 << 20), request);
  EXPECT_EQ(*ReadFile(Path("args"), 1 << 20), "--ca a b\n");
  const std::string environment = *ReadFile(Path("environment"), 1 << 20);
  EXPECT_THAT(
      absl::StrSplit(environment, '\n', absl::SkipEmpty()),
      UnorderedElementsAre(absl::StrCat("PATH=", getenv("PATH")),
                           absl::StrCat("RIPS_IDENTITY=", kSensorName), "RIPS_ROLE=sensor",
                           "RIPS_ROBOT=r1", "RIPS_HOST=base", "RIPS_DAYS=1", "RIPS_SECONDS=86400"));
  EXPECT_THAT(Token(), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(*ReadFile(Path("environment"), 1 << 20),
              AllOf(HasSubstr("RIPS_IDENTITY=spiffe://fleet.example/enrolment/"),
                    HasSubstr("RIPS_ROLE=enrolment\n"), HasSubstr("RIPS_ROBOT=r1\n"),
                    HasSubstr("RIPS_HOST=base\n"), HasSubstr("RIPS_DAYS=1\n"),
                    HasSubstr("RIPS_SECONDS=3600\n")));
}

TEST_F(ExternalCaTest, WrongCertificatesAreRefusedWithAnAlertAndAreNotRecorded) {
  Program(
      "openssl ecparam -name prime256v1 -genkey -noout -out @/other.key\n"
      "openssl req -new -key @/other.key -subj / > @/other.csr\n" +
      absl::StrReplaceAll(Signing(), {{"-in csr.$$", "-in other.csr"}}));
  enrolment();
  const auto wrong = absl::StatusCode::kFailedPrecondition;
  EXPECT_THAT(Failure("wrong", wrong), HasSubstr("public key is not that of the request"));
  EXPECT_THAT(alerts_, ElementsAre(AllOf(HasSubstr("r1 high no certificate for spiffe://"),
                                         HasSubstr("public key"))));
  const std::pair<std::string, std::string> bad[] = {
      {Signing(",DNS:base"), "has 2 names"},
      {Signing("\\nbasicConstraints=CA:TRUE"), "CA:TRUE"},
      {Signing("", "3"), "valid for too long"},
      {Signing("", "1", "faketime -f +5m"), "not valid yet"},
      {Signing("", "1", "faketime -f -2d"), "has expired"},
      {"head -c 3000 /dev/urandom", "nothing else"},
      {"cat @/ca/issuing.pem", "public key"},
      {"cat @/ca/issuing.key", "nothing else"},
      {"exit 0", "no certificate in it"}};
  for (const auto& [body, why] : bad) {
    Program(body);
    EXPECT_THAT(Failure("wrong", wrong),
                AllOf(HasSubstr(why), HasSubstr("gave a wrong certificate")));
    EXPECT_THAT(alerts_, ElementsAre(AllOf(HasSubstr("r1 high"), HasSubstr(why))));
  }
  const rpc::TestPki foreign;
  Program(absl::StrReplaceAll(Signing(), {{"ca/", absl::StrCat(foreign.dir(), "/ca/")}}));
  EXPECT_THAT(Failure("wrong", wrong), HasSubstr("does not lead to a root of `tls.ca`"));
  Program("exec cat /dev/zero");
  EXPECT_THAT(Failure("wrong", wrong), HasSubstr("printed more than 65536 bytes"));
  Program("exec cat /dev/zero >&2");
  EXPECT_THAT(Failure("wrong", wrong), HasSubstr("printed more than 65536 bytes"));
  // The same agent, when the program is mended.
  Program(Signing());
  EXPECT_THAT(Renew(), IsOk());
}

TEST_F(ExternalCaTest, ASerialNumberIsUsedOnce) {
  Program(absl::StrReplaceAll(Signing(), {{"0x$(openssl rand -hex 15)", "0x1f"}}));
  enrolment();
  ASSERT_THAT(Renew(), IsOk());
  alerts_.clear();
  EXPECT_THAT(Renew(), StatusIs(absl::StatusCode::kFailedPrecondition,
                                HasSubstr("its serial number 1f is that of an earlier one")));
  EXPECT_THAT(alerts_, ElementsAre(HasSubstr("r1 high")));
  EXPECT_THAT(*store_->ListIssued(""), SizeIs(1));
}

TEST_F(ExternalCaTest, TryAgainLaterIsUnavailableWithoutAnAlert) {
  enrolment();
  Program("echo sealed >&2; exit 75");
  testing::internal::CaptureStderr();
  const std::string why = Failure("try_later", absl::StatusCode::kUnavailable);
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("stderr=sealed"));
  EXPECT_THAT(why, AllOf(HasSubstr("try again later"), Not(HasSubstr("sealed"))));
  EXPECT_THAT(alerts_, IsEmpty());
}

TEST_F(ExternalCaTest, AProgramThatASignalEndedHasRefusedNothing) {
  enrolment();
  Program("kill -9 $$");
  EXPECT_THAT(Failure("killed", absl::StatusCode::kUnavailable),
              HasSubstr("was ended by signal 9; try again later"));
  EXPECT_THAT(alerts_, IsEmpty());
}

TEST_F(ExternalCaTest, WhyItRefusesIsOneHarmlessLineOfTheLog) {
  enrolment();
  Program(
      "printf 'no\\n2026-01-01T00:00:00Z error forged\\n\\033[2J\\001' >&2; "
      "head -c 5000 /dev/zero >&2; exit 1");
  testing::internal::CaptureStderr();
  const std::string why = Failure("refused", absl::StatusCode::kPermissionDenied);
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(why, AllOf(HasSubstr("exit code 1"), Not(HasSubstr("forged"))));
  EXPECT_THAT(log, AllOf(HasSubstr("no; 2026-01-01T00:00:00Z error forged"),
                         HasSubstr("reason=refused"), HasSubstr(kSensorName)));
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
  EXPECT_TRUE(std::none_of(log.begin(), log.end() - 1, [](char byte) {
    return static_cast<unsigned char>(byte) < 0x20;
  })) << log;
  EXPECT_LT(log.size(), 8 * kExternalCaReasonBytesMax);
  EXPECT_THAT(alerts_, ElementsAre(HasSubstr("r1 medium")));
}

TEST_F(ExternalCaTest, OneThatHangsIsKilledWithItsGroup) {
  const auto code = absl::StatusCode::kUnavailable;
  enrolment({}, absl::Milliseconds(200));
  for (const char* body : {"exec sleep 600", "exec >&- 2>&- sleep 600", "sleep 600 & wait"}) {
    Program(body);
    EXPECT_THAT(Failure("timeout", code), HasSubstr("did not end within 200ms")) << body;
    EXPECT_THAT(alerts_, IsEmpty());
  }
}

TEST_F(ExternalCaTest, OnlyItsEndCountsNotThatOfWhatItStarted) {
  Program("sleep 600 &\n" + Signing() + "exec >&- 2>&-\ntrue\n");
  enrolment();
  EXPECT_THAT(Renew(), IsOk()) << "the child kept its outputs open";
}

TEST_F(ExternalCaTest, AnUnusableProgramIsNamedWithWhatToDo) {
  const auto code = absl::StatusCode::kFailedPrecondition;
  enrolment();
  EXPECT_THAT(Failure("unusable", code), HasSubstr("cannot be found"));
  EXPECT_THAT(alerts_, ElementsAre(HasSubstr("r1 high")));
  Program(Signing());
  ASSERT_EQ(chmod(Path("sign").c_str(), 0775), 0);
  EXPECT_THAT(Failure("unusable", code), HasSubstr("can be written by its group"));
  ASSERT_EQ(chmod(Path("sign").c_str(), 0757), 0);
  EXPECT_THAT(Failure("unusable", code), HasSubstr("chmod go-w"));
  ASSERT_EQ(chmod(Path("sign").c_str(), 0644), 0);
  EXPECT_THAT(Failure("unusable", code), HasSubstr("is not executable"));
  EXPECT_THAT(CheckExternalCaProgram(pki_.dir()), StatusIs(code, HasSubstr("no regular file")));
  EXPECT_THAT(CheckExternalCaProgram("sign"), StatusIs(code, HasSubstr("not an absolute path")));
  EXPECT_THAT(CheckExternalCaProgram(""), StatusIs(code, HasSubstr("not an absolute path")));
  ASSERT_EQ(chmod(Path("sign").c_str(), 0755), 0);
  EXPECT_THAT(CheckExternalCaProgram(Path("sign")), IsOk());
  ASSERT_THAT(WriteFileAtomically(Path("sign"), "#!/nowhere/sh\n", 0755), IsOk());
  ASSERT_EQ(chmod(Path("sign").c_str(), 0755), 0);
  EXPECT_THAT(Failure("not_started", code), HasSubstr("name an interpreter that is there"));
}

TEST_F(ExternalCaTest, ATokenIsGivenBackWhenItsCallFails) {
  Program(Signing());
  enrolment();
  const auto token = Token();
  ASSERT_THAT(token, IsOk());
  const std::string key = *pki::NewKey();
  for (const char* body : {"exit 75", "exit 1", "echo x"}) {
    Program(body);
    EXPECT_FALSE(Enrol(*token, key).ok());
  }
  Program(Signing());
  EXPECT_THAT(Enrol(*token, *pki::NewKey()), IsOk()) << "also by another key: none has been used";
}

TEST_F(ExternalCaTest, OfTwoThatShowOneTokenAtOnceOneGetsACertificate) {
  Program(Signing());
  enrolment();
  const auto token = Token();
  ASSERT_THAT(token, IsOk());
  ASSERT_EQ(mkfifo(Path("gate").c_str(), 0600), 0);
  Program("read line < @/gate\n" + Signing());
  std::optional<absl::StatusOr<Fetched>> first;
  const std::string key = *pki::NewKey();
  std::thread calling([&] { first = Enrol(*token, key); });
  {
    // Open once the program reads.
    const UniqueFd gate(open(Path("gate").c_str(), O_WRONLY | O_CLOEXEC));
    EXPECT_THAT(Enrol(*token, *pki::NewKey()),
                StatusIs(absl::StatusCode::kUnavailable, HasSubstr("try again later")));
    EXPECT_THAT(Enrol(*token, key), StatusIs(absl::StatusCode::kUnavailable));
  }
  calling.join();
  ASSERT_THAT(*first, IsOk());
  EXPECT_THAT(Enrol(*token, *pki::NewKey()),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("by another key")));
  EXPECT_EQ(Enrol(*token, key)->certificates_pem, (*first)->certificates_pem);
  EXPECT_THAT(*store_->ListIssued(""), SizeIs(1));
}

TEST_F(ExternalCaTest, WhatIsRevokedOrBannedMeanwhileGetsNothing) {
  Program(Signing());
  enrolment();
  const auto token = Token();
  ASSERT_THAT(token, IsOk());
  ASSERT_EQ(mkfifo(Path("gate").c_str(), 0600), 0);
  Program("read line < @/gate\n" + Signing());
  const auto meanwhile = [&](const std::function<void()>& act) {
    std::optional<absl::StatusOr<Fetched>> fetched;
    std::thread calling([&] { fetched = Enrol(*token, *pki::NewKey()); });
    {
      const UniqueFd gate(open(Path("gate").c_str(), O_WRONLY | O_CLOEXEC));
      act();
    }
    calling.join();
    return fetched->status();
  };
  EXPECT_THAT(meanwhile([&] { banned_ = true; }), StatusIs(absl::StatusCode::kPermissionDenied));
  banned_ = false;
  EXPECT_THAT(meanwhile([&] { ASSERT_THAT(enrolment_->RevokeToken(token->record.id), IsOk()); }),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("revoked")));
  EXPECT_THAT(*store_->ListIssued(""), IsEmpty());
}

TEST_F(ExternalCaTest, TheServersEndEndsWhatRuns) {
  Program("read line < @/gate; read line < @/gate");
  enrolment();
  ASSERT_EQ(mkfifo(Path("gate").c_str(), 0600), 0);
  std::optional<absl::StatusOr<Fetched>> renewed;
  std::thread calling([&] { renewed = Renew(); });
  { const UniqueFd gate(open(Path("gate").c_str(), O_WRONLY | O_CLOEXEC)); }
  ca_->Stop();
  calling.join();
  EXPECT_THAT(*renewed, StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is stopping")));
  EXPECT_THAT(Renew(), StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(failures_, IsEmpty());
}

TEST_F(ExternalCaTest, TheExampleSigns) {
  enrolment({RIPS_EXAMPLE_CA, Path("ca")});
  const auto token = Token();
  ASSERT_THAT(token, IsOk());
  EXPECT_THAT(Enrol(*token, *pki::NewKey()), IsOk());
  EXPECT_THAT(Enrol(*token, *pki::NewKey(), "actuator"), IsOk());
  EXPECT_THAT(Renew(), IsOk());
  enrolment({RIPS_EXAMPLE_CA, Path("nowhere")});
  testing::internal::CaptureStderr();
  EXPECT_THAT(Renew(), StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("is it mounted?"));
}

TEST(SigningThreadsTest, SoManyRunAtATimeAndTheOldestFirst) {
  Mutex mu;
  CondVar changed;
  int running = 0;
  int most = 0;
  int done = 0;
  bool open = false;
  {
    SigningThreads threads(2);
    for (int i = 0; i < 6; ++i) {
      ASSERT_TRUE(threads.Push([&] {
        MutexLock lock(&mu);
        most = std::max(most, ++running);
        changed.NotifyAll();
        while (!open) changed.Wait(lock);
        --running;
        ++done;
      }));
    }
    MutexLock lock(&mu);
    while (running < 2) changed.Wait(lock);
    open = true;
    changed.NotifyAll();
  }
  EXPECT_EQ(most, 2);
  EXPECT_EQ(done, 6) << "its end waits for all";
  SigningThreads none(0);
  for (size_t i = 0; i < SigningThreads::kWaitingMax; ++i) ASSERT_TRUE(none.Push([] {}));
  EXPECT_FALSE(none.Push([] {}));
}

}  // namespace
}  // namespace rips::enrol
