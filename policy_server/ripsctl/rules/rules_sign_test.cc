// `ripsctl rules sign`.
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/policy/bundle/key_samples.h"
#include "policy_server/ripsctl/offline_run.h"
#include "services/base/status_matchers.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class RulesSignTest : public testing::Test {
 protected:
  RulesSignTest() {
    directory_.Write("first/manifest.yaml", "name: first\nrules: [first.rul]\nlevels: [A, B]\n");
    directory_.Write("first/first.rul", "levels: A; B;\nrules Msg: true ? trigger(B);\n");
    WriteKey(key_.private_pem);
  }
  void WriteKey(const std::string& pem, mode_t mode = 0600) {
    directory_.Write("alice.key", pem);
    EXPECT_EQ(chmod(key_path_.c_str(), mode), 0);
  }
  Result Sign(const std::vector<std::string>& more = {}) {
    std::vector<std::string> args = {"rules", "sign", dir_, "--key", key_path_};
    args.insert(args.end(), more.begin(), more.end());
    return RunOffline(args);
  }
  // Expects that no signature was written.
  void ExpectUnsigned(const Result& result, int code, const std::string& why) {
    EXPECT_EQ(result.code, code) << why;
    EXPECT_THAT(result.err, HasSubstr(why));
    EXPECT_EQ(result.out, "");
    EXPECT_FALSE(std::filesystem::exists(dir_ + "/signature")) << why;
  }

  const bundle::SampleKey key_ = bundle::MakeEd25519();
  const TestDirectory directory_;
  const std::string dir_ = directory_.path() + "/first";
  const std::string key_path_ = directory_.path() + "/alice.key";
};

TEST_F(RulesSignTest, ASignedBundleIsVerifiedByThePublicKey) {
  const std::string id = bundle::CheckBundle(dir_).id;

  const Result result = Sign();

  EXPECT_EQ(result.code, 0) << result.err;
  const auto signature = bundle::ReadSignature(dir_);
  ASSERT_THAT(signature, IsOk());
  const std::string key_id = signature->substr(8, 16);
  EXPECT_EQ(result.out, absl::StrCat("signed ", id, " with key ", key_id,
                                     "\npublic key for the server: openssl pkey -in ", key_path_,
                                     " -pubout -out NAME.pem\n"));
  const auto keys = bundle::SignerKeys::Load({directory_.Write("keys/alice.pem", key_.public_pem)});
  ASSERT_THAT(keys, IsOk());
  EXPECT_THAT(keys->Verify(bundle::CheckBundle(dir_).id, *signature), IsOk());
  EXPECT_FALSE(std::filesystem::exists(dir_ + "/signature.tmp"));

  directory_.Write("first/first.rul", "levels: A; B;\nrules Msg: false ? trigger(B);\n");
  EXPECT_THAT(keys->Verify(bundle::CheckBundle(dir_).id, *signature),
              StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_EQ(Sign().code, 0) << "again";
  EXPECT_THAT(keys->Verify(bundle::CheckBundle(dir_).id, *bundle::ReadSignature(dir_)), IsOk());
}

TEST_F(RulesSignTest, JsonNamesTheIdAndTheKey) {
  const Result result = Sign({"--output", "json"});
  EXPECT_EQ(result.code, 0) << result.err;
  const auto signature = bundle::ReadSignature(dir_);
  ASSERT_THAT(signature, IsOk());
  EXPECT_EQ(nlohmann::json::parse(result.out, nullptr, false),
            nlohmann::json({{"name", "first"},
                            {"id", bundle::CheckBundle(dir_).id},
                            {"key_id", signature->substr(8, 16)},
                            {"signature", dir_ + "/signature"}}));
}

TEST_F(RulesSignTest, ALinkAtItsPlaceIsReplacedAndNotFollowed) {
  const std::string other = directory_.Write("other", "mine");
  std::filesystem::create_symlink(other, dir_ + "/signature");
  EXPECT_EQ(Sign().code, 0);
  EXPECT_FALSE(std::filesystem::is_symlink(dir_ + "/signature"));
  std::ifstream file(other);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(file), {}), "mine");
}

TEST_F(RulesSignTest, RefusesABundleWithErrors) {
  const std::string why = absl::StrCat("`ripsctl rules check ", dir_, "` shows why");
  directory_.Write("first/first.rul", "levels: A\n");
  ExpectUnsigned(Sign(), 1, why);
  ExpectUnsigned(Sign({"--output", "json"}), 1, why);
  std::filesystem::remove(dir_ + "/first.rul");
  ExpectUnsigned(Sign(), 1, why);
  std::filesystem::remove(dir_ + "/manifest.yaml");
  ExpectUnsigned(Sign(), 1, why);
  std::filesystem::remove_all(dir_);
  ExpectUnsigned(Sign(), 1, why);
}

TEST_F(RulesSignTest, RefusesAKeyThatOthersMayRead) {
  for (const mode_t mode : {0640, 0604, 0644, 0620, 0601, 0777}) {
    WriteKey(key_.private_pem, mode);
    ExpectUnsigned(Sign(), 2, absl::StrCat("run `chmod 600 ", key_path_, "`"));
  }
  WriteKey(key_.private_pem, 0400);
  EXPECT_EQ(Sign().code, 0);
}

TEST_F(RulesSignTest, RefusesWhatIsNotOnePrivateEd25519Key) {
  const std::pair<std::string, std::string> cases[] = {
      {"", "is not a key in PEM"},
      {key_.public_pem, "is a public key"},
      {key_.encrypted_pem, "is encrypted"},
      {bundle::MakeRsa().private_pem, "is a key of kind RSA, not Ed25519"},
      {std::string(10 << 20, 'A'), "is longer than the limit"},
      {"\x1b[2J", "is not a key in PEM"},
  };
  for (const auto& [pem, why] : cases) {
    WriteKey(pem);
    const Result result = Sign();
    ExpectUnsigned(result, 2, why);
    EXPECT_THAT(result.err, AllOf(HasSubstr(key_path_), Not(HasSubstr("\x1b"))));
  }
  std::filesystem::remove(key_path_);
  ExpectUnsigned(Sign(), 2, "alice.key");
  std::filesystem::create_directory(key_path_);
  ExpectUnsigned(Sign(), 2, "is not a regular file");
}

TEST_F(RulesSignTest, ASignatureThatCannotBeWrittenIsAnError) {
  std::filesystem::create_directories(dir_ + "/signature/x");
  const Result result = Sign();
  EXPECT_EQ(result.code, 1);
  EXPECT_THAT(result.err, HasSubstr("first/signature`"));
  EXPECT_FALSE(std::filesystem::exists(dir_ + "/signature.tmp"));
}

TEST_F(RulesSignTest, WrongArgumentsAreUsageErrors) {
  EXPECT_EQ(RunOffline({"rules", "sign"}).code, 2);
  EXPECT_EQ(RunOffline({"rules", "sign", dir_}).code, 2);
  EXPECT_EQ(RunOffline({"rules", "sign", dir_, dir_, "--key", key_path_}).code, 2);
  EXPECT_EQ(RunOffline({"--key", key_path_, "rules", "sign", dir_}).code, 2)
      << "that key is the one to connect with";
  EXPECT_FALSE(std::filesystem::exists(dir_ + "/signature"));
}

}  // namespace
}  // namespace rips::ripsctl
