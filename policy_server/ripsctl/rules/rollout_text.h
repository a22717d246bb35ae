// Bundles and roll-outs as operators read them, and as programs do.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_ROLLOUT_TEXT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_ROLLOUT_TEXT_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/text_stream.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// What stands for the bundle in the server's directory.
inline constexpr absl::string_view kDirectoryBundle = "directory";

// OK for an id or at least its first 8 digits, with or without `sha256:`.
absl::Status CheckBundleId(absl::string_view bundle);
// An id as the protocol has it, where empty means the directory's: short, or `directory`.
std::string ShortBundleOrDirectory(absl::string_view id);
// As ShortBundle, each with as many digits more as it takes to tell it from the others.
std::vector<std::string> ShortBundles(const std::vector<std::string>& ids);

// `r1, r2, r3 and 5 more`.
std::string NamedRobots(const google::protobuf::RepeatedPtrField<std::string>& robots,
                        size_t most = 8);

// `alice: lunch` for `alice (spiffe://td/operator/admin/alice serial 0a): lunch`: certificates are
// for records, and JSON.
std::string WithoutCertificates(absl::string_view text);

// `running: stage 1 of 2 (r2) has been healthy for 3 of 10 min`; as it was at `now_unix_ns`.
std::string RolloutState(const v1::Rollout& rollout, int64_t now_unix_ns);
// As RolloutState, but the same as long as nothing changes but the time: for a line per change.
std::string RolloutProgress(const v1::Rollout& rollout);
// All of it: what, by whom and why, its limits, its stages. Nothing if there was none.
void PrintRollout(const v1::Rollout& rollout, int64_t now_unix_ns, TextStream out);
// The roll-out's stages.
void PrintStages(const v1::Rollout& rollout, TextStream out);
// `10min healthy for each stage; stops at more than 10 alerts a minute of one robot`.
std::string RolloutLimits(const v1::Rollout& rollout);

// {"id","bundle","name","from_directory","state","why","operator","reason","began","ended",
//  "stages":[{"state","robots":[..]}],"healthy_since","soak_ms","alerts_per_minute_max",
//  "roll_back_when_stopped"}; times are null when there are none; null if there was no roll-out.
Json ToJson(const v1::Rollout& rollout);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_ROLLOUT_TEXT_H_
