// Each question about the graph is answered yes and no: at both ends of a range, with one name too
// few and one too many, and of a topic or node that is not there.
#include <map>
#include <ostream>
#include <set>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

// 3 nodes; 3 topics: /a has 3 publishers of 2 nodes, and 2 subscribers; /b has 1 publisher and none;
// /c has none and 1. /base offers 3 services, /ns/cam 1, /nav none.
ros2::RosGraph SomeGraph() {
  TestGraph graph;
  graph.Node("/base").Node("/ns/cam").Node("/nav");
  graph.Publishes("/base", "/a").Publishes("/base", "/a").Publishes("/ns/cam", "/a");
  graph.Subscribes("/nav", "/a").Subscribes("/ns/cam", "/a");
  graph.Publishes("/nav", "/b").Subscribes("/base", "/c");
  graph.Serves("/base", "/s1").Serves("/base", "/s2").Serves("/base", "/s3");
  graph.Serves("/ns/cam", "/ns/on");
  return graph.Build();
}

struct Case {
  Builtin builtin;
  std::string what;  // of messages: the topic; of others: a word for the failure
  std::vector<std::string> names;
  // Counts only.
  int64_t min = -1, max = -1;
  bool yes = false;
};

bool IsAboutTheMessage(Builtin builtin) {
  return builtin == Builtin::kSubscriberCount || builtin == Builtin::kPublisherCount;
}

// Both in `rules Msg` and in `rules Graph`, if it may stand there.
std::vector<bool> Answers(const Case& each) {
  Exprs args = Texts(each.names);
  if (each.min != -1 || each.max != -1) {
    args.push_back(I(each.min));
    args.push_back(I(each.max));
  }
  TestRules rules;
  rules.Msg("m", Call(each.builtin, args), {{Alert("yes")}});
  if (!IsAboutTheMessage(each.builtin)) {
    rules.Graph("g", Call(each.builtin, args), {{Alert("yes")}});
  }
  TestRobot robot(rules);
  robot.state.graph = SomeGraph();
  std::vector<bool> out;
  const Outcome message =
      robot.Message(IsAboutTheMessage(each.builtin) ? each.what : "/a", "std_msgs/msg/String");
  EXPECT_EQ(message.faults, 0u);
  out.push_back(message.fired == 1);
  if (!IsAboutTheMessage(each.builtin)) out.push_back(robot.Graph().fired == 1);
  return out;
}

// Every number of `of` is in a range that ends or begins with it, and in none beside it.
void Range(std::vector<Case>& out, Builtin builtin, const std::string& what,
           const std::vector<std::string>& names, int64_t of) {
  const auto add = [&](int64_t min, int64_t max, bool yes) {
    out.push_back(
        {.builtin = builtin, .what = what, .names = names, .min = min, .max = max, .yes = yes});
  };
  add(of, of, true);
  add(of, of + 1, true);
  add(of - 1, of, true);
  add(of + 1, of + 2, false);
  add(of - 2, of - 1, false);
  add(of + 1, of - 1, false);
  add(0, 1'000'000, true);
}

std::vector<Case> Counts() {
  std::vector<Case> out;
  Range(out, Builtin::kSubscriberCount, "/a", {}, 2);
  Range(out, Builtin::kSubscriberCount, "/b", {}, 0);
  Range(out, Builtin::kSubscriberCount, "/c", {}, 1);
  Range(out, Builtin::kSubscriberCount, "/unknown", {}, 0);
  Range(out, Builtin::kTopicCount, "topics", {}, 3);
  Range(out, Builtin::kServiceCount, "full name", {"/base"}, 3);
  Range(out, Builtin::kServiceCount, "base name", {"cam"}, 1);
  Range(out, Builtin::kServiceCount, "another name space", {"/cam"}, 0);
  Range(out, Builtin::kServiceCount, "none", {"/nav"}, 0);
  Range(out, Builtin::kServiceCount, "no such node", {"/ghost"}, 0);
  Range(out, Builtin::kTopicPublisherCount, "two in one node", {"/a"}, 3);
  Range(out, Builtin::kTopicPublisherCount, "one", {"/b"}, 1);
  Range(out, Builtin::kTopicPublisherCount, "none", {"/c"}, 0);
  Range(out, Builtin::kTopicPublisherCount, "no such topic", {"/unknown"}, 0);
  Range(out, Builtin::kTopicSubscriberCount, "two", {"/a"}, 2);
  Range(out, Builtin::kTopicSubscriberCount, "none", {"/b"}, 0);
  Range(out, Builtin::kTopicSubscriberCount, "one", {"/c"}, 1);
  Range(out, Builtin::kTopicSubscriberCount, "no such topic", {"/unknown"}, 0);
  return out;
}

// The answer to `names`, behind `of` if that is not empty: the topic or node that is asked about.
struct Names {
  std::string of;
  std::vector<std::string> names;
  bool yes = false;
};

void Add(std::vector<Case>& out, Builtin builtin, const std::vector<Names>& list) {
  for (const Names& each : list) {
    std::vector<std::string> names = each.names;
    if (!each.of.empty()) names.insert(names.begin(), each.of);
    out.push_back({.builtin = builtin, .what = "names", .names = names, .yes = each.yes});
  }
}

std::vector<Case> Sets() {
  std::vector<Case> out;
  Add(out, Builtin::kTopicPublishers,
      {{"/a", {"/base", "/ns/cam"}, true},
       {"/a", {"cam", "base", "base"}, true},
       {"/a", {"/base"}, false},
       {"/a", {"/base", "/ns/cam", "/nav"}, false},
       {"/a", {"/base", "/cam"}, false},
       {"/c", {}, true},
       {"/c", {"/base"}, false},
       {"/unknown", {}, true},
       {"/unknown", {"/base"}, false}});
  Add(out, Builtin::kTopicSubscribers,
      {{"/a", {"/nav", "/ns/cam"}, true},
       {"/a", {"cam", "nav", "nav"}, true},
       {"/a", {"/nav"}, false},
       {"/a", {"/nav", "/ns/cam", "/base"}, false},
       {"/a", {"/nav", "/cam"}, false},
       {"/b", {}, true},
       {"/b", {"/nav"}, false},
       {"/unknown", {}, true},
       {"/unknown", {"/nav"}, false}});
  Add(out, Builtin::kHasTopics,
      {{"", {}, true},
       {"", {"/a"}, true},
       {"", {"/a", "/b", "/c", "/a"}, true},
       {"", {"/a", "/d"}, false},
       {"", {"a"}, false},
       {"", {"/A"}, false}});
  Add(out, Builtin::kHasServices,
      {{"/base", {}, true},
       {"/base", {"/s1", "/s3"}, true},
       {"base", {"/s1", "/s2", "/s3"}, true},
       {"/base", {"/s1", "/s4"}, false},
       {"/base", {"/ns/on"}, false},
       {"cam", {"/ns/on"}, true},
       {"/cam", {"/ns/on"}, false},
       {"/ghost", {"/s1"}, false},
       {"/ghost", {}, true}});
  Add(out, Builtin::kHasTopicPublishers,
      {{"/a", {}, true},
       {"/a", {"/base"}, true},
       {"/a", {"base", "cam"}, true},
       {"/a", {"/base", "/nav"}, false},
       {"/a", {"/cam"}, false},
       {"/b", {"/base"}, false},
       {"/unknown", {"/base"}, false},
       {"/unknown", {}, true}});
  Add(out, Builtin::kHasTopicSubscribers,
      {{"/a", {}, true},
       {"/a", {"/nav"}, true},
       {"/a", {"nav", "cam"}, true},
       {"/a", {"/nav", "/base"}, false},
       {"/a", {"/cam"}, false},
       {"/c", {"/nav"}, false},
       {"/unknown", {"/nav"}, false},
       {"/unknown", {}, true}});
  return out;
}

void Check(const std::vector<Case>& cases, size_t builtins) {
  std::map<Builtin, std::set<bool>> answers;
  for (const Case& each : cases) {
    for (const bool answer : Answers(each)) {
      EXPECT_EQ(answer, each.yes) << "builtin " << static_cast<int>(each.builtin) << ", "
                                  << each.what << ": " << testing::PrintToString(each.names) << ", "
                                  << each.min << " to " << each.max;
      answers[each.builtin].insert(answer);
    }
  }
  EXPECT_EQ(answers.size(), builtins);
  for (const auto& [builtin, given] : answers) {
    EXPECT_EQ(given.size(), 2u) << "builtin " << static_cast<int>(builtin) << " is asked one way";
  }
}

TEST(GraphQuestionTest, CountsAreInTheirRangeAndInNoneBesideIt) { Check(Counts(), 5); }

TEST(GraphQuestionTest, SetsAreAskedWithTooFewAndTooManyNames) { Check(Sets(), 6); }

}  // namespace
}  // namespace rips::engine
