// What the policy server wants to be told of each topic: an ordered table, the first match wins.
//
// Two lists decide what is read of a topic. The interest comes from the server and follows its
// rules. `unwatched` is the robot owner's: its topics are read only if a rule of the interest that
// wants messages names the topic literally (LiteralTopics). A pattern that happens to match, as one
// for everything does, is not enough.
#ifndef RIPS_SENSOR_AGENT_INTEREST_INTEREST_H_
#define RIPS_SENSOR_AGENT_INTEREST_INTEREST_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "re2/re2.h"
#include "services/base/payload_limits.h"
#include "services/ros2/graph_limits.h"

namespace rips::sensor {

struct InterestRule {
  // RE2, searched in the topic name; empty = every topic.
  std::string topic_regex;
  // Exact ROS type; empty = any.
  std::string type;
  // First bytes of each payload that are sent along; 0 = metadata only.
  uint32_t payload_bytes_max = 0;
  // False: messages are not needed, not even their metadata.
  bool messages = true;
};

// Of payloads that a rule asks for: instead of its payload_bytes_max.
struct PayloadLimit {
  // RE2, searched in the topic name; empty = every topic.
  std::string topic_regex;
  uint32_t bytes = 0;
};

// What is read of one topic.
struct Wanted {
  bool messages = false;
  // At most kPayloadBytesHard; 0 = metadata only.
  uint32_t payload_bytes = 0;

  friend bool operator==(const Wanted&, const Wanted&) = default;
};

// Bytes of a table's id.
inline constexpr size_t kInterestIdBytes = 32;
inline constexpr size_t kInterestRulesMax = 1'024;
// RE2 instructions of all patterns of a table.
inline constexpr size_t kInterestInstructionsMax = 200'000;
// RE2's memory for a pattern; for one that does not fit, the larger. The number of larger ones is
// bounded by their instructions.
inline constexpr int64_t kInterestPatternBytes = int64_t{64} << 10;
inline constexpr int64_t kInterestPatternBytesMax = int64_t{1} << 20;

// Immutable; any thread.
class Interest {
 public:
  // InvalidArgument: an id of another length, a bad pattern. ResourceExhausted: past a limit. The
  // message names the rule or the payload limit, counted from 1. The first of `limits` that matches
  // counts.
  static absl::StatusOr<std::shared_ptr<const Interest>> Create(
      std::string id, std::vector<InterestRule> rules, std::vector<PayloadLimit> limits = {},
      ros2::TopicNames kept_topics = {});

  const std::string& id() const { return id_; }
  // As the first rule says that matches; nothing if none does.
  Wanted Of(absl::string_view topic, absl::string_view type) const;
  // A rule that wants messages names this topic literally, whatever its type.
  bool Names(absl::string_view topic) const { return literal_.contains(topic); }
  // Their endpoints are kept first when the graph is at its limits.
  const std::shared_ptr<const ros2::TopicNames>& kept_topics() const { return kept_topics_; }

 private:
  struct Rule {
    std::unique_ptr<const RE2> topic;  // null = every topic
    std::string type;
    Wanted wanted;
  };
  struct Limit {
    std::unique_ptr<const RE2> topic;  // null = every topic
    uint32_t bytes = 0;
  };
  explicit Interest(std::string id) : id_(std::move(id)) {}

  const std::string id_;
  std::vector<Rule> rules_;
  std::vector<Limit> limits_;
  absl::flat_hash_set<std::string> literal_;
  std::shared_ptr<const ros2::TopicNames> kept_topics_;
};

// The topics that `regex` names literally: those of `^NAME$` and of `^(?:NAME|NAME...)$`, where
// NAME is a ROS topic name, any character of which may be quoted as RE2::QuoteMeta does. None for
// every other pattern, also for one that matches a single name in another way.
std::vector<std::string> LiteralTopics(absl::string_view regex);

struct WatchOptions {
  // ROS topics that are not read unless the interest names them literally.
  std::vector<std::string> unwatched;
  // Null = metadata of everything.
  std::shared_ptr<const Interest> interest;
  // Nothing is read: graph and messages are another host's to report.
  bool idle = false;
};

// What is read of every topic, all told. Its answers never change. One thread.
class WatchPlan {
 public:
  explicit WatchPlan(WatchOptions options) : options_(std::move(options)) {}

  Wanted Of(absl::string_view topic, absl::string_view type) const;

 private:
  Wanted Find(absl::string_view topic, absl::string_view type) const;

  const WatchOptions options_;
  // By topic and type: hundreds of patterns are asked once.
  mutable absl::flat_hash_map<std::pair<std::string, std::string>, Wanted> answers_;
};

// Answers a WatchPlan remembers; past them it begins anew.
inline constexpr size_t kWatchAnswersMax = 16'384;

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_INTEREST_INTEREST_H_
