#include "mode_actuator/steps/firewall/fragment.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/firewall_config.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/runtime/atomic_file.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(FragmentTest, ReadsChainsAndRules) {
  constexpr absl::string_view kText = R"(# Only the base station.
chain input {
  udp dport 7400-7500 ip saddr != { 10.0.0.2, 10.0.0.3 } counter drop  # DDS
  log prefix "a # b" drop
}

chain output {
  @ih,0,32 0x52545053 drop
}
chain forward {
}
)";
  for (const std::string& text :
       {std::string(kText),
        absl::StrReplaceAll(kText, {{"input {", "input\t {\t"}, {"\n  ", "\n\t"}})}) {
    const auto rules = ParseFragment("a.nft", text);
    ASSERT_THAT(rules, IsOk());
    EXPECT_THAT(*rules,
                ElementsAre(FragmentRule{Hook::kInput,
                                         "udp dport 7400-7500 ip saddr != { 10.0.0.2, 10.0.0.3 } "
                                         "counter drop",
                                         3},
                            FragmentRule{Hook::kInput, "log prefix \"a # b\" drop", 4},
                            FragmentRule{Hook::kOutput, "@ih,0,32 0x52545053 drop", 8}))
        << text;
  }
}

TEST(FragmentTest, RefusesWhatCouldLeaveItsChain) {
  const struct {
    std::string rule;
    absl::string_view message;
  } kCases[] = {
      {"drop; flush ruleset", "a.nft:2: a rule cannot hold `;`"},
      {"log prefix \"; x\" drop", "a rule cannot hold `;`"},
      {"drop \\", "cannot hold `\\`"},
      {"ip saddr $admin drop", "cannot hold `$`"},
      {"jump input", "cannot use `jump`"},
      {"goto\tlevel_out", "cannot use `goto`"},
      {"tcp dport vmap { 22 : jump x }", "cannot use `vmap`"},
      {"handle 7 drop", "cannot use `handle`"},
      {"position 7 drop", "cannot use `position`"},
      {"index 0 drop", "cannot use `index`"},
      {"drop comment \"rips 1\"", "cannot use `comment`"},
      {"include \"/etc/shadow\"", "cannot use `include`"},
      {"define x = 1", "cannot use `define`"},
      {"ip saddr @control4 drop", "cannot name a set"},
      {"add @control4 { ip saddr . tcp dport }", "cannot name a set"},
      {"meter x { ip saddr limit rate 1/second } drop", "cannot use `meter`"},
      {"ip saddr { 10.0.0.1", "`{` is not closed on its line"},
      {"ip saddr 10.0.0.1 } drop", "`}` without `{`"},
      {"chain output {", "`{` is not closed on its line"},
      {"log prefix \"open drop", "a quote is not closed"},
      {"drop\r", "only printable ASCII"},
      {std::string("drop \0 x", 8), "only printable ASCII"},
      {"drop \xc2\xa0", "only printable ASCII"},
      {std::string(kFragmentLineBytesMax + 1, 'x'), "a line of 1025 bytes exceeds limit 1024"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(ParseFragment("a.nft", absl::StrCat("chain input {\n", test.rule, "\n}\n")),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.rule;
  }
}

TEST(FragmentTest, RefusesTextsOfAnotherShape) {
  const struct {
    std::string text;
    absl::string_view message;
  } kCases[] = {
      {"", "a.nft: there is no rule in it"},
      {"chain input {\n}\n", "there is no rule in it"},
      {"chain input {\n drop\n", "the last chain is not closed"},
      {"drop\n", "a.nft:1: `drop` is outside of a chain"},
      {"table inet other {\n}\n", "`table inet other {` is outside of a chain"},
      {"flush ruleset\n", "is outside of a chain"},
      {"chain prerouting {\n drop\n}\n", "chain `prerouting` is none of"},
      {"chain input { drop }\n", "is outside of a chain"},
      {std::string(kFragmentBytesMax + 1, '\n'), "65537 bytes exceed limit 65536"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(ParseFragment("a.nft", test.text),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.text.substr(0, 100);
  }
}

TEST(FragmentTest, HasALimitOfRules) {
  std::string text = "chain input {\n";
  for (size_t i = 0; i < kFragmentRulesMax; ++i) absl::StrAppend(&text, "drop\n");
  EXPECT_THAT(ParseFragment("a.nft", text + "}\n"), IsOk());
  EXPECT_THAT(ParseFragment("a.nft", text + "drop\n}\n"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("rules exceed limit 256")));
}

TEST(FragmentTest, EveryCutAndEveryByteIsReadOrRefusedWithoutHarm) {
  const std::string text = "chain input {\n log prefix \"a\" ip saddr { 10.0.0.1 } drop\n}\n";
  for (size_t length = 0; length < text.size(); ++length) {
    EXPECT_EQ(ParseFragment("a.nft", text.substr(0, length)).ok(), length == text.size() - 1);
  }
  for (size_t at = 0; at < text.size(); ++at) {
    for (int byte = 0; byte < 256; ++byte) {
      std::string changed = text;
      changed[at] = static_cast<char>(byte);
      const auto rules = ParseFragment("a.nft", changed);
      if (!rules.ok()) continue;
      for (const FragmentRule& rule : *rules) {
        EXPECT_EQ(rule.text.find_first_of(";\n\\$`"), std::string::npos) << rule.text;
      }
    }
  }
}

TEST(FragmentTest, TheShippedFileIsOne) {
  const auto text = ReadFile(RIPS_SOURCE_DIR "/deploy/config/alert.nft", kFragmentBytesMax);
  ASSERT_THAT(text, IsOk());
  const auto rules = ParseFragment("alert.nft", *text);
  ASSERT_THAT(rules, IsOk());
  EXPECT_EQ(rules->size(), 3u);
}

class FragmentFileTest : public ::testing::Test {
 protected:
  FragmentFileTest() {
    char name[] = "/tmp/rips-fragment-XXXXXX";
    directory_ = mkdtemp(name);
    path_ = directory_ + "/a.nft";
    EXPECT_THAT(WriteFileAtomically(path_, "chain input {\n drop\n}\n"), IsOk());
  }
  ~FragmentFileTest() override {
    unlink(path_.c_str());
    unlink((directory_ + "/link").c_str());
    rmdir(directory_.c_str());
  }
  std::string directory_;
  std::string path_;
};

TEST_F(FragmentFileTest, ReadsAFileThatOnlyItsOwnerCanWrite) {
  EXPECT_THAT(ReadFragment(path_), IsOk());
}

TEST_F(FragmentFileTest, RefusesFilesThatOthersControl) {
  chmod(path_.c_str(), 0620);
  EXPECT_THAT(ReadFragment(path_),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("chmod go-w")));
  chmod(path_.c_str(), 0644);
  symlink(path_.c_str(), (directory_ + "/link").c_str());
  EXPECT_THAT(ReadFragment(directory_ + "/link"),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("symbolic link")));
  EXPECT_THAT(ReadFragment(directory_),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("no regular file")));
  EXPECT_THAT(ReadFragment(directory_ + "/none"), StatusIs(absl::StatusCode::kNotFound));
  mkfifo((directory_ + "/fifo").c_str(), 0600);
  EXPECT_THAT(ReadFragment(directory_ + "/fifo"), StatusIs(absl::StatusCode::kPermissionDenied));
  unlink((directory_ + "/fifo").c_str());
  if (!RootMay({CAP_CHOWN})) GTEST_SKIP() << "giving a file away needs CAP_CHOWN";
  ASSERT_EQ(chown(path_.c_str(), 65534, 65534), 0);
  EXPECT_THAT(ReadFragment(path_),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not owned by root")));
}

TEST_F(FragmentFileTest, RefusesAFileThatIsTooLong) {
  ASSERT_THAT(WriteFileAtomically(path_, std::string(kFragmentBytesMax + 1, '#')), IsOk());
  EXPECT_THAT(ReadFragment(path_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exceed limit 65536")));
}

}  // namespace
}  // namespace rips::actuator
