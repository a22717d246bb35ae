#include "policy_server/policy/bundle/bundle_signature.h"

#include <openssl/err.h>
#include <stdlib.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/key_samples.h"
#include "services/base/status_matchers.h"

namespace rips::bundle {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::Not;

namespace fs = std::filesystem;

class SignatureTest : public testing::Test {
 protected:
  SignatureTest() {
    std::string name = (fs::temp_directory_path() / "rips-signature-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
  }
  ~SignatureTest() override {
    std::error_code ignored;
    fs::remove_all(root_, ignored);
  }
  // The file's path.
  std::string WriteFile(const std::string& name, const std::string& text) {
    fs::create_directories((root_ / name).parent_path());
    std::ofstream(root_ / name, std::ios::binary) << text;
    return (root_ / name).string();
  }
  // The trusted key `alice`.
  SignerKeys Alice() {
    auto keys = SignerKeys::Load({WriteFile("alice.pem", alice_.public_pem)});
    EXPECT_THAT(keys, IsOk());
    return *keys;
  }

  const std::string id_ = absl::StrCat("sha256:", Sha256Hex("a bundle"));
  const SampleKey alice_ = MakeEd25519();
  const SampleKey bob_ = MakeEd25519();
  fs::path root_;
};

TEST_F(SignatureTest, IsOneLineThatTheKeyVerifies) {
  const auto signature = SignBundle(id_, alice_.private_pem);
  ASSERT_THAT(signature, IsOk());
  EXPECT_THAT(*signature, MatchesRegex("ed25519 [0-9a-f]{16} [A-Za-z0-9+/]{86}==\n"));
  EXPECT_LE(signature->size(), kSignatureBytesMax);
  EXPECT_EQ(*SignBundle(id_, alice_.private_pem), *signature) << "Ed25519 uses no random number";
  const auto signer = Alice().Verify(id_, *signature);
  ASSERT_THAT(signer, IsOk());
  EXPECT_EQ(*signer, "alice");
}

TEST_F(SignatureTest, OneOfSeveralKeysVerifies) {
  const auto keys = SignerKeys::Load(
      {WriteFile("alice.pem", alice_.public_pem), WriteFile("keys/bob-2026", bob_.public_pem)});
  ASSERT_THAT(keys, IsOk());
  EXPECT_FALSE(keys->empty());
  EXPECT_EQ(*keys->Verify(id_, *SignBundle(id_, alice_.private_pem)), "alice");
  EXPECT_EQ(*keys->Verify(id_, *SignBundle(id_, bob_.private_pem)), "bob-2026");
}

TEST_F(SignatureTest, AnyByteOfTheIdOrTheSignatureThatIsAnotherIsDenied) {
  const SignerKeys keys = Alice();
  const std::string signature = *SignBundle(id_, alice_.private_pem);
  for (int bit = 0; bit < 8; ++bit) {
    for (size_t i = 0; i < id_.size(); ++i) {
      std::string other = id_;
      other[i] = static_cast<char>(other[i] ^ (1 << bit));
      EXPECT_THAT(keys.Verify(other, signature), StatusIs(absl::StatusCode::kPermissionDenied))
          << i << " " << bit;
    }
    for (size_t i = 0; i < signature.size(); ++i) {
      std::string other = signature;
      other[i] = static_cast<char>(other[i] ^ (1 << bit));
      EXPECT_THAT(keys.Verify(id_, other), StatusIs(absl::StatusCode::kPermissionDenied))
          << i << " " << bit;
    }
  }
  EXPECT_EQ(ERR_peek_error(), 0u) << "nothing is left for the thread's next TLS call";
}

TEST_F(SignatureTest, SaysWhyItIsDeniedAndHowToSign) {
  const SignerKeys keys = Alice();
  const std::string good = *SignBundle(id_, alice_.private_pem);
  const std::string bobs = *SignBundle(id_, bob_.private_pem);
  const std::string key_id = good.substr(8, 16);
  const std::string bobs_key_id = bobs.substr(8, 16);
  const struct {
    std::string signature;
    std::string why;
  } cases[] = {
      {"", "has no signature"},
      {bobs, absl::StrCat("signed with the key ", bobs_key_id, ", which is none of")},
      {absl::StrReplaceAll(bobs, {{bobs_key_id, key_id}}), "of the key `alice` for other content"},
      {*SignBundle("sha256:0", alice_.private_pem), "of the key `alice` for other content"},
      {"\n", "malformed"},
      {"ed25519", "malformed"},
      {"ed25519 \n", "malformed"},
      {"ed25519  \n", "malformed"},
      {absl::StrCat("ed25519 ", key_id, "\n"), "malformed"},
      {absl::StrCat("ed25519 ", key_id, " \n"), "malformed"},
      {absl::StrCat("ed25519 ", key_id, " AAAA\n"), "malformed"},
      {absl::StrCat("ed25519 ", key_id, " ", std::string(86, '*'), "==\n"), "malformed"},
      {absl::StrCat("rsa ", good.substr(8)), "malformed"},
      {absl::StrCat(" ", good), "malformed"},
      {absl::StrCat(good, good), "malformed"},
      {absl::StrCat(good, bobs), "malformed"},
      {absl::StrCat(good, "\n"), "malformed"},
      {absl::StrCat(good, "x"), "malformed"},
      {absl::StrCat(good, std::string(1, '\0')), "malformed"},
      {absl::StrReplaceAll(good, {{"\n", "\r\n"}}), "malformed"},
      {absl::StrReplaceAll(good, {{"==\n", "\n"}}), "malformed"},
      {absl::StrReplaceAll(good, {{"==", "= ="}}), "malformed"},
      {absl::StrReplaceAll(good, {{key_id, key_id.substr(1)}}), "malformed"},
      {absl::StrReplaceAll(good, {{key_id, std::string(16, 'A')}}), "malformed"},
      {good.substr(0, good.size() - 1), "malformed"},
      {std::string(1 << 20, 'A'), "malformed"},
  };
  for (const auto& each : cases) {
    EXPECT_THAT(keys.Verify(id_, each.signature),
                StatusIs(absl::StatusCode::kPermissionDenied,
                         AllOf(HasSubstr(each.why), HasSubstr(id_),
                               HasSubstr("`ripsctl rules sign DIR --key FILE`"))))
        << each.signature.substr(0, 200);
  }
  for (size_t cut = 0; cut < good.size(); ++cut) {
    EXPECT_THAT(keys.Verify(id_, good.substr(0, cut)),
                StatusIs(absl::StatusCode::kPermissionDenied));
  }
}

TEST_F(SignatureTest, WithoutKeysNothingIsVerified) {
  EXPECT_TRUE(SignerKeys().empty());
  EXPECT_TRUE(SignerKeys::Load({})->empty());
  EXPECT_THAT(SignerKeys().Verify(id_, *SignBundle(id_, alice_.private_pem)),
              StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST_F(SignatureTest, OnlyPublicEd25519KeysAreLoaded) {
  const SampleKey rsa = MakeRsa();
  const std::string cut = alice_.public_pem.substr(0, alice_.public_pem.size() / 2);
  const struct {
    std::string text;
    std::string why;
  } cases[] = {
      {"", "is empty"},
      {rsa.public_pem, "is a key of kind RSA, not Ed25519"},
      {MakeX25519().public_pem, "is a key of kind X25519, not Ed25519"},
      {alice_.private_pem, "is a private key; write the public one with `openssl pkey -in"},
      {alice_.encrypted_pem, "is a private key"},
      {rsa.private_pem, "is a private key"},
      {absl::StrCat(alice_.public_pem, bob_.public_pem), "has several PEM blocks"},
      {absl::StrCat(alice_.public_pem, alice_.private_pem), "has several PEM blocks"},
      {cut, "cannot be read as a key in PEM"},
      {absl::StrReplaceAll(alice_.public_pem, {{"MC", "\x80\xff"}}), "cannot be read as a key"},
      {absl::StrReplaceAll(alice_.public_pem, {{"PUBLIC KEY", "CERTIFICATE"}}), "cannot be read"},
      {"ed25519", "is not a key in PEM"},
      {std::string(100, '\0'), "is not a key in PEM"},
  };
  for (const auto& each : cases) {
    const std::string path = WriteFile("key.pem", each.text);
    EXPECT_THAT(SignerKeys::Load({path}),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr(absl::StrCat("`", path, "`")), HasSubstr(each.why))))
        << each.why;
  }
  EXPECT_EQ(ERR_peek_error(), 0u) << "nothing is left for the thread's next TLS call";
}

TEST_F(SignatureTest, AKeyFileThatCannotBeReadIsNamed) {
  const std::string huge = WriteFile("huge.pem", std::string(10 << 20, 'A'));
  EXPECT_THAT(SignerKeys::Load({huge}),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr(huge)));
  const std::string none = (root_ / "none.pem").string();
  EXPECT_THAT(SignerKeys::Load({none}), StatusIs(absl::StatusCode::kNotFound, HasSubstr(none)));
  fs::create_directory(root_ / "directory.pem");
  EXPECT_THAT(SignerKeys::Load({(root_ / "directory.pem").string()}),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("directory.pem")));
  ASSERT_EQ(mkfifo((root_ / "pipe.pem").c_str(), 0600), 0);
  EXPECT_THAT(SignerKeys::Load({(root_ / "pipe.pem").string()}),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("pipe.pem")));
  EXPECT_THAT(SignerKeys::Load({""}), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(SignatureTest, NamesAndKeysAreDistinct) {
  const std::string alice = WriteFile("alice.pem", alice_.public_pem);
  const std::string copy = WriteFile("copy.pem", alice_.public_pem);
  const std::string other_alice = WriteFile("other/alice.pem", bob_.public_pem);
  EXPECT_THAT(SignerKeys::Load({alice, copy}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr(copy), HasSubstr("is the same key as `alice`"))));
  EXPECT_THAT(
      SignerKeys::Load({alice, other_alice}),
      StatusIs(absl::StatusCode::kInvalidArgument,
               AllOf(HasSubstr(other_alice), HasSubstr("has the name `alice` of another key"))));
  for (const char* name : {".pem", "a b.pem", "a\x1b[1m.pem", "\xff.pem", "a`.pem"}) {
    EXPECT_THAT(
        SignerKeys::Load({WriteFile(name, alice_.public_pem)}),
        StatusIs(absl::StatusCode::kInvalidArgument,
                 AllOf(HasSubstr("gives no name"), Not(HasSubstr("\x1b")), Not(HasSubstr("\xff")))))
        << name;
  }
  const std::string longest(64, 'x');
  EXPECT_THAT(SignerKeys::Load({WriteFile(longest + ".pem", alice_.public_pem)}), IsOk());
  EXPECT_THAT(SignerKeys::Load({WriteFile(longest + "x.pem", alice_.public_pem)}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("gives no name")));
}

TEST_F(SignatureTest, OnlyAPrivateEd25519KeySigns) {
  const SampleKey rsa = MakeRsa();
  const struct {
    std::string pem;
    std::string why;
  } cases[] = {
      {"", "the private key is not a key in PEM; make one with `openssl genpkey"},
      {alice_.public_pem, "the private key is not a private key"},
      {alice_.encrypted_pem, "the private key is encrypted; decrypt it"},
      {rsa.private_pem, "the private key is a key of kind RSA, not Ed25519"},
      {MakeX25519().private_pem, "is a key of kind X25519, not Ed25519"},
      {alice_.private_pem.substr(0, 60), "the private key "},
      {absl::StrCat(alice_.private_pem, bob_.private_pem), "has several PEM blocks"},
  };
  for (const auto& each : cases) {
    EXPECT_THAT(SignBundle(id_, each.pem),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(each.why)));
  }
}

TEST_F(SignatureTest, IsReadFromTheDirectoryItselfOnly) {
  const std::string dir = root_ / "bundle";
  EXPECT_THAT(ReadSignature(dir), StatusIs(absl::StatusCode::kNotFound));
  fs::create_directory(dir);
  ASSERT_THAT(ReadSignature(dir), IsOk());
  EXPECT_EQ(*ReadSignature(dir), "");

  WriteFile("bundle/signature", std::string(kSignatureBytesMax, 'x'));
  ASSERT_THAT(ReadSignature(dir), IsOk());
  EXPECT_EQ(ReadSignature(dir)->size(), kSignatureBytesMax);
  WriteFile("bundle/signature", std::string(kSignatureBytesMax + 1, 'x'));
  EXPECT_THAT(ReadSignature(dir),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("`signature`")));

  fs::remove(root_ / "bundle/signature");
  fs::create_symlink(WriteFile("elsewhere", "text"), root_ / "bundle/signature");
  EXPECT_THAT(ReadSignature(dir),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("symbolic link")));
  fs::remove(root_ / "bundle/signature");
  fs::create_directory(root_ / "bundle/signature");
  EXPECT_THAT(ReadSignature(dir), StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::bundle
