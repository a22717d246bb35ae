#include "sensor_agent/interest/interest.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

std::unique_ptr<const RE2> Compile(const std::string& pattern, int64_t memory) {
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(memory);
  return std::make_unique<const RE2>(pattern, options);
}

absl::StatusOr<std::unique_ptr<const RE2>> Compile(const std::string& pattern) {
  std::unique_ptr<const RE2> regex = Compile(pattern, kInterestPatternBytes);
  if (regex->error_code() == RE2::ErrorPatternTooLarge) {
    regex = Compile(pattern, kInterestPatternBytesMax);
  }
  if (regex->ok()) return regex;
  if (regex->error_code() == RE2::ErrorPatternTooLarge) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the pattern needs more than ", kInterestPatternBytesMax, " bytes"));
  }
  // RE2's own words quote the pattern, which is rule text.
  return absl::InvalidArgumentError(
      absl::StrCat("bad pattern: RE2 error ", static_cast<int>(regex->error_code())));
}

// Of one table: compiles its patterns, and counts their instructions.
class Patterns {
 public:
  // Null for an empty pattern. `what` is put before the text of an error.
  absl::StatusOr<std::unique_ptr<const RE2>> Compile(const std::string& pattern,
                                                     absl::string_view what) {
    if (pattern.empty()) return nullptr;
    absl::StatusOr<std::unique_ptr<const RE2>> regex = sensor::Compile(pattern);
    if (!regex.ok()) {
      return absl::Status(regex.status().code(),
                          absl::StrCat(what, ": ", regex.status().message()));
    }
    instructions_ += static_cast<size_t>((*regex)->ProgramSize());
    if (instructions_ > kInterestInstructionsMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat(what, ": with it, the patterns exceed the limit of ",
                       kInterestInstructionsMax, " instructions"));
    }
    return regex;
  }

 private:
  size_t instructions_ = 0;
};

// The text that a pattern without operators matches; empty if it has any.
std::string Unquote(absl::string_view pattern) {
  std::string text;
  for (size_t i = 0; i < pattern.size(); ++i) {
    char c = pattern[i];
    if (c == '\\') {
      // Behind a backslash letters and digits mean something else.
      if (++i == pattern.size() || absl::ascii_isalnum(pattern[i])) return {};
      c = pattern[i];
    } else if (!absl::ascii_isalnum(c) && c != '_' && c != '/') {
      return {};
    }
    text.push_back(c);
  }
  return text;
}

}  // namespace

std::vector<std::string> LiteralTopics(absl::string_view regex) {
  if (!absl::ConsumePrefix(&regex, "^") || !absl::ConsumeSuffix(&regex, "$")) return {};
  const bool group = absl::ConsumePrefix(&regex, "(?:");
  if (group && !absl::ConsumeSuffix(&regex, ")")) return {};
  std::vector<std::string> names;
  // A topic name has no bar, so a quoted one makes a name that is refused.
  for (absl::string_view pattern : absl::StrSplit(regex, '|')) {
    std::string name = Unquote(pattern);
    if (!ros2::ValidateTopicName(name).ok()) return {};
    names.push_back(std::move(name));
  }
  // Without a group `^a|b$` is two patterns, each open at one end.
  if (names.size() > 1 && !group) return {};
  return names;
}

absl::StatusOr<std::shared_ptr<const Interest>> Interest::Create(std::string id,
                                                                 std::vector<InterestRule> rules,
                                                                 std::vector<PayloadLimit> limits,
                                                                 ros2::TopicNames kept_topics) {
  if (id.size() != kInterestIdBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("the id has ", id.size(), " bytes, not ", kInterestIdBytes));
  }
  if (rules.size() > kInterestRulesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(rules.size(), " rules exceed the limit of ", kInterestRulesMax));
  }
  if (limits.size() > kPayloadLimitsMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(limits.size(), " payload limits exceed the limit of ", kPayloadLimitsMax));
  }
  if (kept_topics.size() > ros2::kKeptTopicsMax) {
    return absl::ResourceExhaustedError(absl::StrCat(
        kept_topics.size(), " topics to keep exceed the limit of ", ros2::kKeptTopicsMax));
  }
  std::shared_ptr<Interest> interest(new Interest(std::move(id)));
  interest->kept_topics_ = std::make_shared<const ros2::TopicNames>(std::move(kept_topics));
  Patterns patterns;
  for (size_t i = 0; i < rules.size(); ++i) {
    Rule rule{.type = std::move(rules[i].type)};
    if (rules[i].messages) {
      rule.wanted = {.messages = true,
                     .payload_bytes = std::min(rules[i].payload_bytes_max, kPayloadBytesHard)};
      for (std::string& name : LiteralTopics(rules[i].topic_regex)) {
        interest->literal_.insert(std::move(name));
      }
    }
    RIPS_ASSIGN_OR_RETURN(rule.topic,
                          patterns.Compile(rules[i].topic_regex, absl::StrCat("rule ", i + 1)));
    interest->rules_.push_back(std::move(rule));
  }
  for (size_t i = 0; i < limits.size(); ++i) {
    Limit limit{.bytes = std::min(limits[i].bytes, kPayloadBytesHard)};
    RIPS_ASSIGN_OR_RETURN(limit.topic, patterns.Compile(limits[i].topic_regex,
                                                        absl::StrCat("payload limit ", i + 1)));
    interest->limits_.push_back(std::move(limit));
  }
  return interest;
}

Wanted Interest::Of(absl::string_view topic, absl::string_view type) const {
  const re2::StringPiece name(topic.data(), topic.size());
  for (const Rule& rule : rules_) {
    if (!rule.type.empty() && rule.type != type) continue;
    if (rule.topic != nullptr && !RE2::PartialMatch(name, *rule.topic)) continue;
    Wanted wanted = rule.wanted;
    if (wanted.payload_bytes == 0) return wanted;
    for (const Limit& limit : limits_) {
      if (limit.topic != nullptr && !RE2::PartialMatch(name, *limit.topic)) continue;
      wanted.payload_bytes = limit.bytes;
      break;
    }
    return wanted;
  }
  return {};
}

Wanted WatchPlan::Of(absl::string_view topic, absl::string_view type) const {
  if (options_.idle) return {};
  const auto key = std::make_pair(std::string(topic), std::string(type));
  if (const auto known = answers_.find(key); known != answers_.end()) return known->second;
  if (answers_.size() >= kWatchAnswersMax) answers_.clear();
  return answers_[key] = Find(topic, type);
}

Wanted WatchPlan::Find(absl::string_view topic, absl::string_view type) const {
  const Interest* interest = options_.interest.get();
  const auto& unwatched = options_.unwatched;
  if (std::find(unwatched.begin(), unwatched.end(), topic) != unwatched.end() &&
      (interest == nullptr || !interest->Names(topic))) {
    return {};
  }
  return interest == nullptr ? Wanted{.messages = true} : interest->Of(topic, type);
}

}  // namespace rips::sensor
