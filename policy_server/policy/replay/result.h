// Result: what rules made of a recording.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RESULT_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RESULT_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::replay {

// When something happened.
struct Moment {
  // 0-based index in the recording. A tick has that of the event before it.
  uint64_t event = 0;
  // Nanoseconds since the Unix epoch, or, if the recording has no times, since its start.
  int64_t time_ns = 0;

  friend bool operator==(const Moment&, const Moment&) = default;
};

struct Alerted {
  Moment at;
  std::string rule;
  std::string text;
  engine::Severity severity = engine::Severity::kMedium;

  friend bool operator==(const Alerted&, const Alerted&) = default;
};

// A level decision, or one that was refused.
struct Changed {
  Moment at;
  std::string rule;
  // Names.
  std::string from;
  std::string to;
  bool refused = false;
  // Why it was refused: "needs an operator", "blind", ...
  std::string reason;

  friend bool operator==(const Changed&, const Changed&) = default;
};

struct Executed {
  Moment at;
  std::string rule;
  std::string program;
  std::vector<std::string> args;
  bool ok = false;

  friend bool operator==(const Executed&, const Executed&) = default;
};

// A fault, or what `True` and `False` were given.
struct Noted {
  Moment at;
  std::string rule;
  std::string text;

  friend bool operator==(const Noted&, const Noted&) = default;
};

struct RuleHits {
  std::string name;
  // kMsg, kGraph or kExternal.
  lang::EventClass section = lang::EventClass::kMsg;
  // Events of its class that were judged, whether or not they could concern it.
  uint64_t evaluated = 0;
  uint64_t fired = 0;
  // It asked what the recording does not hold, and did not fire.
  uint64_t undecidable = 0;
  // It asked an inspection that could not tell. It fired all the same, and is counted there, unless
  // ProgramOptions::on_inspection_error has it otherwise.
  uint64_t unscanned = 0;
  // Of those: it asked for what was left out of a truncated graph.
  uint64_t graph_truncated = 0;
  // Time it took, in all; 0 unless it was measured. What all rules of an event share counts for the
  // first that is run.
  int64_t total_ns = 0;

  int64_t mean_ns() const {
    return evaluated == 0 ? 0 : total_ns / static_cast<int64_t>(evaluated);
  }
  friend bool operator==(const RuleHits&, const RuleHits&) = default;
};

// A place where the recording lacks what it should hold.
struct Missing {
  // The last event before it; none if there is none. Its time is 0 if the recording has no times.
  std::optional<Moment> after;
  // From the first event to that one; may be negative if times go back.
  int64_t after_ns = 0;
  // Nothing behind it was read.
  bool end = false;
  // What is missing, in which file and where.
  std::string text;

  friend bool operator==(const Missing&, const Missing&) = default;
};

struct EventCounts {
  // By class, also those after a rule has called `crash`; ticks are external.
  uint64_t message = 0;
  uint64_t graph = 0;
  uint64_t external = 0;
  // Events of which at least one rule asked what the recording does not hold.
  uint64_t undecidable = 0;
  // Messages that do not say which node sent them, and of these, those of no known writer either.
  uint64_t unattributed = 0;
  uint64_t unattributed_writer = 0;

  friend bool operator==(const EventCounts&, const EventCounts&) = default;
};

// Lists are in the order things happened.
struct Result {
  EventCounts events;
  // Name, at the end.
  std::string level;
  std::vector<Changed> transitions;
  std::vector<Alerted> alerts;
  std::vector<Executed> execs;
  std::vector<Noted> faults;
  std::vector<Noted> logs;
  absl::btree_map<std::string, lang::Value> variables;
  // In the order of the program.
  std::vector<RuleHits> rules;
  // A rule called `crash` there; none ran afterwards.
  std::optional<Moment> crashed;
  // The recording has times.
  bool timed = false;
  // Not empty: the recording is cut, damaged, or lacks a file.
  std::vector<Missing> missing;
  // Entries that the lists had no room for (ReplayOptions::records_max).
  uint64_t left_out = 0;

  friend bool operator==(const Result&, const Result&) = default;
};

// The lists of a Result.
struct Records {
  std::vector<Changed> transitions;
  std::vector<Alerted> alerts;
  std::vector<Executed> execs;
  std::vector<Noted> faults;
  std::vector<Noted> logs;
};

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RESULT_H_
