// Which bundles operators have activated for which robots, which run muted beside them, and the
// newest roll-out: durable, in one file that is replaced whole.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_ACTIVATED_BUNDLES_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_ACTIVATED_BUNDLES_H_

#include <cstdint>
#include <optional>
#include <set>
#include <string>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/server/rollout/rollout.h"
#include "policy_server/server/store/store.h"

namespace rips::rollout {

struct Activation {
  // `sha256:` + 64 hex digits; empty = whatever the server's directory holds.
  std::string bundle_id;
  // The policy's name in the inventory then: under another one the activation does not count.
  std::string name;
  std::string operator_name;
  std::string reason;
  int64_t time_unix_ns = 0;
  // What a roll-back goes to, as `bundle_id`; nullopt = nothing was activated before that, or it
  // has been rolled back.
  std::optional<std::string> before;

  friend bool operator==(const Activation&, const Activation&) = default;
};

struct ShadowOrder {
  std::string bundle_id;
  std::string operator_name;
  std::string reason;

  friend bool operator==(const ShadowOrder&, const ShadowOrder&) = default;
};

// By robot.
struct ActivatedBundles {
  absl::btree_map<std::string, Activation> robots;
  absl::btree_map<std::string, ShadowOrder> shadows;
  std::optional<RolloutRecord> rollout;

  // Ids of all bundles that these name.
  std::set<std::string> bundles() const;

  friend bool operator==(const ActivatedBundles&, const ActivatedBundles&) = default;
};

// What is activated, and what of it counts for a robot. One thread at a time.
//
// If the file is damaged or cannot be read, it is not known what was activated: each robot that is
// asked for keeps the bundle that judged it last, as the store has it, until an operator activates
// another one. So it is if the file is not the one that was written last, as the store knows: it
// was removed, or an older one took its place. A damaged file is also kept as PATH.damaged.
class Activations {
 public:
  // `store` is not owned and outlives this.
  Activations(std::string path, store::Store* store);

  // Why the file could not be read; OK = it was, or there was none.
  const absl::Status& problem() const { return problem_; }
  const ActivatedBundles& now() const { return now_; }
  // Makes `next` durable, then it counts. ResourceExhausted (also: more than the file may hold),
  // Unavailable: the old ones count.
  absl::Status Set(ActivatedBundles next);
  // Id of the bundle that was activated for the robot; empty = the directory's.
  std::string For(const bundle::InventoryRobot& robot);

 private:
  // The store knows that what is there now, or `text`, is what was written last.
  absl::Status Announce(const std::string& text);

  const std::string path_;
  store::Store* const store_;
  absl::Status problem_;
  ActivatedBundles now_;
};

// As JSON. DataLoss: it is none, or of what cannot be; fields that this version does not know are
// passed over.
absl::StatusOr<ActivatedBundles> ParseActivatedBundles(const std::string& text);
absl::StatusOr<std::string> FormatActivatedBundles(const ActivatedBundles& activated);

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_ACTIVATED_BUNDLES_H_
