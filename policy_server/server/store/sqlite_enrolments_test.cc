#include "policy_server/server/store/sqlite_enrolments.h"

#include <stdlib.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::store {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

class SqliteEnrolmentsTest : public ::testing::Test {
 protected:
  SqliteEnrolmentsTest() {
    char name[] = "/tmp/rips-enrolments-XXXXXX";
    EXPECT_NE(mkdtemp(name), nullptr);
    directory_ = name;
    Open();
  }
  ~SqliteEnrolmentsTest() override { std::filesystem::remove_all(directory_); }
  void Open() {
    store_.reset();
    auto opened = SqliteEnrolments::Open(path());
    ASSERT_THAT(opened, IsOk());
    store_ = *std::move(opened);
  }
  std::string path() const { return directory_ + "/enrolment.db"; }
  static TokenRecord Token(const std::string& id, int64_t time = 100, int64_t expires = 200) {
    return {.id = id,
            .robot = "r1",
            .host = "base",
            .roles = "actuator,sensor",
            .by = "spiffe://td/operator/admin/root serial 1",
            .time_unix_ns = time,
            .expires_unix_ns = expires};
  }
  static IssuedRecord Issued(const std::string& uri, const std::string& serial,
                             const std::string& key, const std::string& token = "") {
    return {.uri = uri,
            .serial = serial,
            .key_hash = key,
            .token = token,
            .time_unix_ns = 100,
            .not_after_unix_ns = 900};
  }

  std::string directory_;
  std::unique_ptr<SqliteEnrolments> store_;
};

TEST_F(SqliteEnrolmentsTest, KeepsTokensThroughARestartInAFileForItsOwnerAlone) {
  ASSERT_THAT(store_->PutToken(Token("t1")), IsOk());
  ASSERT_THAT(store_->PutToken(Token("t2")), IsOk());
  EXPECT_THAT(store_->PutToken(Token("t1")), StatusIs(absl::StatusCode::kAlreadyExists));
  ASSERT_THAT(store_->RevokeToken("t2"), IsOk());
  EXPECT_THAT(store_->RevokeToken("t3"), StatusIs(absl::StatusCode::kNotFound));
  Open();
  EXPECT_EQ(*store_->FindToken("t1"), Token("t1"));
  TokenRecord revoked = Token("t2");
  revoked.revoked = true;
  EXPECT_THAT(*store_->ListTokens(), ElementsAre(revoked, Token("t1")));
  EXPECT_THAT(store_->FindToken("t3"), StatusIs(absl::StatusCode::kNotFound));
  struct stat info {};
  ASSERT_EQ(stat(path().c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 07777, 0600u);
}

TEST_F(SqliteEnrolmentsTest, ATokenGivesAnIdentityToOneKeyAlone) {
  ASSERT_THAT(store_->PutToken(Token("t1")), IsOk());
  IssuedRecord first = Issued("sensor", "a", "key", "t1");
  first.certificates_pem = "pem of a";
  ASSERT_THAT(store_->PutIssued(first), IsOk());
  EXPECT_THAT(store_->PutIssued(Issued("sensor", "b", "other", "t1")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("another key")));
  ASSERT_THAT(store_->PutIssued(Issued("actuator", "c", "other", "t1")), IsOk());
  EXPECT_THAT(store_->PutIssued(Issued("sensor", "d", "key", "t1")),
              StatusIs(absl::StatusCode::kAlreadyExists));
  IssuedRecord given = Issued("sensor", "a", "key", "t1");
  EXPECT_THAT(*store_->ListIssued("sensor"), ElementsAre(given));
  given.certificates_pem = "pem of a";
  EXPECT_EQ(*store_->FindIssued("t1", "sensor"), given) << "to be given again";
  EXPECT_THAT(store_->FindIssued("t1", "other"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(*store_->ListIssued(""), SizeIs(2));
}

TEST_F(SqliteEnrolmentsTest, ATokenThatIsRevokedOrNotKeptGivesNothing) {
  ASSERT_THAT(store_->PutToken(Token("t1")), IsOk());
  ASSERT_THAT(store_->RevokeToken("t1"), IsOk());
  EXPECT_THAT(store_->PutIssued(Issued("sensor", "a", "key", "t1")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("revoked")));
  EXPECT_THAT(store_->PutIssued(Issued("sensor", "a", "key", "t9")),
              StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(*store_->ListIssued(""), SizeIs(0));
}

TEST_F(SqliteEnrolmentsTest, ListsEachCertificateUntilItEndsAndRefusesTooMany) {
  ASSERT_THAT(store_->PutToken(Token("t1")), IsOk());
  ASSERT_THAT(store_->PutIssued(Issued("sensor", "first", "key", "t1")), IsOk());
  for (int64_t i = 1; i < kGoodPerIdentityMax; ++i) {
    ASSERT_THAT(store_->PutIssued(Issued("sensor", absl::StrCat(i), "key")), IsOk());
  }
  EXPECT_THAT(store_->PutIssued(Issued("sensor", "more", "key")),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("enrol list")));
  ASSERT_THAT(store_->PutIssued(Issued("actuator", "x", "key")), IsOk()) << "of another identity";
  EXPECT_THAT(*store_->ListIssued("sensor"), SizeIs(kGoodPerIdentityMax));

  IssuedRecord later = Issued("sensor", "later", "key");
  later.time_unix_ns = 900;  // the others have ended
  later.not_after_unix_ns = 1'800;
  ASSERT_THAT(store_->PutIssued(later), IsOk());
  EXPECT_THAT(*store_->ListIssued("sensor"),
              ElementsAre(later, Issued("sensor", "first", "key", "t1")))
      << "and what a token was used for, as long as the token is kept";
  EXPECT_THAT(store_->PutIssued(Issued("sensor", "b", "other", "t1")),
              StatusIs(absl::StatusCode::kFailedPrecondition));
}

TEST_F(SqliteEnrolmentsTest, WhatIsNoSuchFileIsNotTouched) {
  const std::string other = directory_ + "/other.db";
  std::ofstream(other) << "not a database, but long enough that one could think so: "
                       << std::string(1'000, 'x');
  EXPECT_FALSE(SqliteEnrolments::Open(other).ok());
  EXPECT_EQ(std::filesystem::file_size(other), 1'057u);
  auto db = Database::Open(path(), Database::Mode::kReadWrite);
  ASSERT_THAT(db->Execute("PRAGMA user_version = 2"), IsOk());
  EXPECT_THAT(SqliteEnrolments::Open(path()),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("version 2")));
  ASSERT_THAT(db->Execute("PRAGMA application_id = 7"), IsOk());
  EXPECT_THAT(SqliteEnrolments::Open(path()), StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_FALSE(SqliteEnrolments::Open(directory_ + "/none/x.db").ok());
  std::filesystem::create_symlink(path(), directory_ + "/link.db");
  EXPECT_FALSE(SqliteEnrolments::Open(directory_ + "/link.db").ok());
}

}  // namespace
}  // namespace rips::store
