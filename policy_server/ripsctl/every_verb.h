// Every verb of ripsctl as a test runs it, and the pages of help that name them.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_EVERY_VERB_H_
#define RIPS_POLICY_SERVER_RIPSCTL_EVERY_VERB_H_

#include <functional>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "gtest/gtest.h"
#include "policy_server/audit/log_samples.h"
#include "policy_server/policy/bundle/key_samples.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/ripsctl/samples.h"

namespace rips::ripsctl {

using Args = std::vector<std::string>;

// The subcommands that a page of help lists.
inline std::vector<std::string> Subcommands(const std::string& help) {
  std::vector<std::string> names;
  const size_t begin = help.find("\nSubcommands:\n");
  if (begin == std::string::npos) return names;
  const size_t from = begin + absl::string_view("\nSubcommands:\n").size();
  const std::string list = help.substr(from, help.find("\n\n", from) - from);
  for (const absl::string_view line : absl::StrSplit(list, '\n')) {
    const absl::string_view name = absl::StripLeadingAsciiWhitespace(line);
    names.emplace_back(name.substr(0, name.find(' ')));
  }
  return names;
}

// The words before --help of every page: of all, of each noun, of each verb. `run` runs ripsctl.
inline std::vector<Args> HelpPages(const std::function<Result(const Args&)>& run) {
  std::vector<Args> pages = {{}};
  for (const std::string& noun : Subcommands(run({"--help"}).out)) {
    pages.push_back({noun});
    for (const std::string& verb : Subcommands(run({noun, "--help"}).out)) {
      pages.push_back({noun, verb});
    }
  }
  return pages;
}

// Such as `level show`, or `explain`.
inline std::string VerbOf(const Args& args) {
  static const std::set<std::string> whole = {"record", "explain", "top", "man"};
  return whole.contains(args[0]) ? args[0] : absl::StrCat(args[0], " ", args[1]);
}

// Each verb that asks the server, with what it needs in `directory`.
inline std::vector<Args> ServerVerbs(const TestDirectory& directory) {
  const std::string recording = directory.path() + "/r1.rips";
  const std::string bundle = directory.path() + "/first";
  directory.Write("first/manifest.yaml", "name: first\nrules: [r.rul]\nlevels: [A]\n");
  directory.Write("first/r.rul", "levels: A;\n");
  return {
      {"robot", "list"},
      {"robot", "watch"},
      {"robot", "show", "r1"},
      {"robot", "graph", "r1"},
      {"robot", "config", "r1"},
      {"robot", "interest", "r1"},
      {"robot", "coverage", "r1"},
      {"robot", "receipts", "r1"},
      {"robot", "drill", "r1"},
      {"robot", "maintenance", "r1", "--end", "--reason", "x"},
      {"level", "show", "r1"},
      {"level", "history", "r1"},
      {"level", "raise", "r1", "--to", "A", "--reason", "x"},
      {"level", "lower", "r1", "--to", "A", "--reason", "x"},
      {"level", "approve", "r1", "333333", "--reason", "x"},
      {"alert", "list"},
      {"alert", "watch"},
      {"alert", "ack", "333333"},
      {"alert", "recording", "1", "--out", recording, "--force"},
      {"explain", "r1"},
      {"rules", "push", bundle},
      {"rules", "list"},
      {"rules", "activate", "directory", "--all", "--reason", "x"},
      {"rules", "rollback", "--all", "--reason", "x"},
      {"rules", "stop", "--reason", "x"},
      {"rules", "status"},
      {"rules", "shadow", "--end", "--all", "--reason", "x"},
      {"rules", "resume", "r1", "--reason", "x"},
      {"signal", "send", "r1", "SIGUSR1", "--reason", "x"},
      {"agent", "list"},
      {"agent", "ban", "spiffe://rips/robot/r1/sensor/base", "--reason", "x"},
      {"agent", "unban", "spiffe://rips/robot/r1/sensor/base"},
      {"agent", "reset-term", "r1", "base", "--reason", "x"},
      {"enrol", "create-token", "r1", "base"},
      {"enrol", "revoke-token", "00112233aabbccdd"},
      {"enrol", "list"},
      {"record", "r1", "--out", recording, "--force"},
  };
}

// Each verb that needs no server, with what it needs in `directory`, which is HOME, too.
inline std::vector<Args> OfflineVerbs(const TestDirectory& directory) {
  const std::string rules = directory.Write("a.rul", "levels:\n  A;\n");
  const std::string test =
      directory.Write("a_test.yaml",
                      "rules: [a.rul]\ntests:\n  - name: stays\n"
                      "    events: [{signal: SIGUSR1}]\n    expect: {level: A}\n");
  const std::string events = directory.Write("a.rips", MakeAlertRecording());
  directory.Write("signed/manifest.yaml", "name: signed\nrules: [r.rul]\nlevels: [A]\n");
  directory.Write("signed/r.rul", "levels: A;\n");
  const std::string key = directory.Write("a.key", bundle::MakeEd25519().private_pem);
  std::filesystem::permissions(key, std::filesystem::perms::owner_read);
  for (const auto& [name, bytes] : audit::TwoSegments().segments.files) {
    directory.Write("audit/" + name, bytes);
  }
  directory.Write(".config/rips/ripsctl.yaml", "contexts: {lab: {server: \"lab.example:1\"}}\n");
  const std::string log = directory.path() + "/audit";
  return {
      {"rules", "check", rules},
      {"rules", "fmt", rules},
      {"rules", "builtins"},
      {"rules", "test", test},
      {"rules", "replay", "--rules", rules, "--events", events},
      {"rules", "sign", directory.path() + "/signed", "--key", key},
      {"audit", "verify", log},
      {"audit", "tail", log},
      {"audit", "export", log},
      {"context", "list"},
      {"context", "use", "lab"},
      {"completion", "bash"},
      {"man"},
  };
}

// A verb that help names and no table has is a failure. `top` shows a screen: it is not in them.
inline void ExpectEveryVerb(const std::vector<Args>& pages, const std::vector<Args>& all) {
  std::set<std::string> tried = {"top"};
  for (const Args& args : all) tried.insert(VerbOf(args));
  std::set<std::string> nouns;
  for (const Args& page : pages) {
    if (page.size() == 2) nouns.insert(page[0]);
  }
  for (const Args& page : pages) {
    const bool is_verb = page.size() == 2 || (page.size() == 1 && !nouns.contains(page[0]));
    EXPECT_TRUE(!is_verb || tried.contains(absl::StrJoin(page, " ")))
        << absl::StrJoin(page, " ") << ": add it to every_verb.h";
  }
}

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_EVERY_VERB_H_
