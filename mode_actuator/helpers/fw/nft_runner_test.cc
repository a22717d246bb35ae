#include "mode_actuator/helpers/fw/nft_runner.h"

#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/helpers/fw/ruleset.h"
#include "services/base/status_matchers.h"
#include "services/runtime/atomic_file.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// A shell script in the place of nft.
class NftRunnerTest : public ::testing::Test {
 protected:
  NftRunnerTest() {
    char name[] = "/tmp/rips-nft-XXXXXX";
    directory_ = mkdtemp(name);
  }
  ~NftRunnerTest() override {
    unlink((directory_ + "/nft").c_str());
    rmdir(directory_.c_str());
  }
  NftRunner Make(absl::string_view body, absl::Duration timeout = absl::Seconds(60)) {
    const std::string path = directory_ + "/nft";
    EXPECT_THAT(WriteFileAtomically(path, absl::StrCat("#!/bin/sh\n", body), 0755), IsOk());
    chmod(path.c_str(), 0755);
    return NftRunner({.path = path, .timeout = timeout});
  }
  std::string directory_;
};

TEST_F(NftRunnerTest, GivesTheScriptOnStandardInput) {
  NftRunner nft = Make(
      "[ \"$*\" = '-c -f -' ] && [ \"$(cat)\" = 'add table x' ] && "
      "[ -z \"$HOME\" ] && [ \"$PWD\" = / ] && exit 0\necho \"$*\" >&2; exit 7\n");
  EXPECT_THAT(nft.Load("add table x", NftMode::kDryRun), IsOk());
  EXPECT_THAT(nft.Load("add table x", NftMode::kCommit),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("(exit code 7): -f -")));
}

TEST_F(NftRunnerTest, PassesALargeScript) {
  NftRunner nft = Make("[ $(cat | wc -c) = 1000000 ]\n");
  EXPECT_THAT(nft.Load(std::string(1'000'000, 'x'), NftMode::kCommit), IsOk());
}

TEST_F(NftRunnerTest, WhatNftSaysIsMadeHarmlessAndCut) {
  NftRunner nft = Make("printf 'bad\\033[2J\\n' >&2; head -c 100000 /dev/zero >&2; exit 1\n");
  const absl::Status status = nft.Load("x", NftMode::kCommit);
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("bad\\x1b[2J")));
  EXPECT_LT(status.message().size(), 2 * kNftErrorBytesMax);
}

TEST_F(NftRunnerTest, AMissingNftIsTold) {
  NftRunner nft({.path = directory_ + "/nft"});
  EXPECT_THAT(nft.Load("x", NftMode::kCommit),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("No such file or directory")));
  EXPECT_THAT(nft.ListTable(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot start")));
}

TEST_F(NftRunnerTest, ANftThatHangsIsKilled) {
  NftRunner hangs = Make("exec sleep 600\n", absl::Milliseconds(300));
  EXPECT_THAT(hangs.Load("x", NftMode::kCommit),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("within 300ms")));
  NftRunner silent = Make("exec >&- 2>&- sleep 600\n", absl::Milliseconds(300));
  EXPECT_FALSE(silent.Load("x", NftMode::kCommit).ok());
}

TEST_F(NftRunnerTest, ANftThatPrintsWithoutEndIsKilled) {
  NftRunner nft = Make("exec cat /dev/zero\n");
  EXPECT_THAT(nft.ListTable(), StatusIs(absl::StatusCode::kResourceExhausted));
}

TEST_F(NftRunnerTest, ANftThatDiesIsTold) {
  NftRunner nft = Make("kill -9 $$\n");
  EXPECT_THAT(nft.Load("x", NftMode::kCommit),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exit code 137")));
}

TEST_F(NftRunnerTest, NoTableIsToldFromOtherFailures) {
  NftRunner none = Make("echo 'Error: No such file or directory' >&2; exit 1\n");
  EXPECT_THAT(none.ListTable(), StatusIs(absl::StatusCode::kNotFound));
  NftRunner refused = Make("echo 'Operation not permitted (you must be root)' >&2; exit 1\n");
  EXPECT_THAT(refused.ListTable(),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("you must be root")));
}

TEST(RulesetTest, ACountThatIsNoneIsNotKnown) {
  const auto dropped = [](absl::string_view counter) {
    return ParseRuleset(absl::StrCat(R"({"nftables": [)", counter, "]}"))->dropped;
  };
  EXPECT_EQ(dropped(""), std::nullopt);
  EXPECT_EQ(dropped(R"({"counter": {"name": "dropped"}})"), std::nullopt);
  EXPECT_EQ(dropped(R"({"counter": {"name": "dropped", "packets": "many"}})"), std::nullopt);
  EXPECT_EQ(dropped(R"({"counter": {"name": "dropped", "packets": -1}})"), std::nullopt);
  EXPECT_EQ(dropped(R"({"counter": {"name": "dropped", "packets": 18446744073709551615}})"),
            UINT64_MAX);
}

TEST(RulesetTest, ReadsWhatNftPrints) {
  const auto ruleset = ParseRuleset(R"({"nftables": [{"metainfo": {"version": "1.0.6"}},
    {"table": {"family": "inet", "name": "rips", "handle": 1}},
    {"counter": {"name": "other", "table": "rips", "packets": 9, "bytes": 9}},
    {"counter": {"name": "dropped", "table": "rips", "packets": 1240, "bytes": 99}},
    {"set": {"name": "quarantine4", "table": "rips", "elem": ["10.0.0.1",
      {"elem": {"val": "10.0.0.2", "timeout": 60, "expires": 59, "comment": "since 77"}}]}},
    {"set": {"name": "bad_guid", "table": "rips", "elem": [{"elem": {"val": 1, "timeout": 2}},
      {"elem": {"val": "0x110000000000000000000a1", "timeout": 9, "expires": 3}}]}},
    {"set": {"name": "dropped4", "table": "rips", "flags": ["timeout"], "timeout": 600, "elem": [
      {"elem": {"val": "10.0.0.66", "expires": 598, "counter": {"packets": 7, "bytes": 9}}},
      {"elem": {"val": "10.0.0.67", "counter": {"packets": -1}}},
      {"elem": {"val": "10.0.0.68", "counter": null}}]}},
    {"set": {"name": "control4", "table": "rips", "elem": [{"concat": ["10.0.0.1", 7443]}]}},
    {"chain": {"name": "input", "type": "filter", "hook": "input", "prio": -150,
      "policy": "accept"}},
    {"rule": {"chain": "input", "handle": 5, "comment": "rips 1",
      "expr": [{"counter": {"packets": 5, "bytes": 7}}, {"drop": null}]}}]})");
  ASSERT_THAT(ruleset, IsOk());
  EXPECT_TRUE(ruleset->present);
  EXPECT_FALSE(ruleset->dormant);
  EXPECT_EQ(ruleset->dropped, 1240u);
  EXPECT_THAT(ruleset->sets.at("quarantine4"),
              ElementsAre(SetElement{"10.0.0.1"}, SetElement{"10.0.0.2", 59, 77}));
  EXPECT_THAT(ruleset->sets.at("bad_guid"), ElementsAre(SetElement{"000000000000000000000001"},
                                                        SetElement{"0110000000000000000000a1", 3}));
  EXPECT_THAT(ruleset->sets.at("dropped4"),
              ElementsAre(SetElement{"10.0.0.66", 598, 0, 7}, SetElement{"10.0.0.67"},
                          SetElement{"10.0.0.68"}));
  EXPECT_THAT(ruleset->sets.at("control4"), ElementsAre(SetElement{"10.0.0.1 . 7443"}));
  EXPECT_EQ(
      ruleset->chains.at("input"),
      (ChainView{"filter input -150 accept", {R"([{"counter":null},{"drop":null}])"}, {"rips 1"}}));
}

TEST(RulesetTest, RefusesWhatIsNoList) {
  for (const absl::string_view text : {"", "{", "[]", "{}", "{\"nftables\": 1}", "\xff"}) {
    EXPECT_THAT(ParseRuleset(text), StatusIs(absl::StatusCode::kDataLoss)) << text;
  }
  // Odd, but a list: what is in it is not taken for something else.
  const auto odd = ParseRuleset(R"({"nftables": [1, null, {"table": 1}, {"rule": {"expr": 5}},
      {"set": {"name": 7, "elem": {"a": 1}}}, {"set": {"name": "x", "elem": [{"elem": 1}]}}]})");
  ASSERT_THAT(odd, IsOk());
  EXPECT_FALSE(odd->present);
}

}  // namespace
}  // namespace rips::actuator
