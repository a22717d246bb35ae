// Why a robot is where it is, as text for people. All that comes from the server may hold anything:
// bytes are escaped, places in the condition are cut to what is there.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_EXPLAIN_TEXT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_EXPLAIN_TEXT_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/text_stream.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// What a dry run found of the next less restrictive level.
struct Lowering {
  std::string to;
  absl::StatusOr<v1::LevelResponse> found;
};

struct Explanation {
  // With an alert or a transition, unless nothing was ever decided.
  v1::ExplainResponse recorded;
  // The robot now, and unset if it is no robot that did it, but the server.
  std::optional<absl::StatusOr<v1::GetLevelResponse>> now;
  // What had raised the robot to the level that `recorded` left, without evidence if that is not
  // known; unset if that was the lowest, or if nothing is known of it.
  std::optional<v1::ExplainResponse> raised;
  // The change before `recorded`, if `raised` is an older one.
  std::optional<v1::Transition> between;
  // Unset at the lowest level.
  std::optional<Lowering> lowering;
  // Of the robot now; unset if no subject has a GUID.
  std::optional<absl::StatusOr<v1::GetGraphResponse>> graph;
  // The findings of the robot now, and the state of the one that `recorded` is about, if it is
  // about one; unset if `now` is, or failed.
  std::optional<absl::StatusOr<v1::GetCoverageResponse>> findings;
};

// Who or what made the rule fire: of the evidence, or else of the alert.
const google::protobuf::RepeatedPtrField<v1::Subject>& SubjectsOf(
    const v1::ExplainResponse& recorded);

// Whether that endpoint or participant is in the graph now. kUnknown if it has no GUID, or if it is
// not in a graph of which not all is seen; kKeptOut if it is not, but a firewall of the robot may
// keep it out.
enum class Presence { kUnknown, kThere, kKeptOut, kGone };
Presence PresenceOf(const v1::Subject& subject, const Explanation& explanation);

// The parts, in this order, each left out if there is nothing to say: what happened, why, who,
// whether the finding still stands, what came of it, which findings stand, what is now.
void PrintExplanation(const Explanation& explanation, TextStream out);

// Why there is no evidence, in one line, not escaped; empty if there is.
std::string NoEvidenceText(const v1::ExplainResponse& recorded);

// Why there is no result of the dry run, in one line, not escaped.
std::string NoDryRunText(const absl::Status& status);

// The bytes of `condition` at `offset`, on one line: comments are left out, each run of white space
// is one blank, at most `columns` columns (at least 3). `...` stands for what is left out.
std::string PieceText(absl::string_view condition, uint32_t offset, uint32_t length,
                      size_t columns);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_EXPLAIN_TEXT_H_
