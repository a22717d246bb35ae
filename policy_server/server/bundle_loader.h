// Loads bundles for a server: with the signature that its configuration wants, plugins contained.
#ifndef RIPS_POLICY_SERVER_SERVER_BUNDLE_LOADER_H_
#define RIPS_POLICY_SERVER_SERVER_BUNDLE_LOADER_H_

#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/policy/inspect/child_process.h"
#include "policy_server/policy/inspect/inspection_pool.h"
#include "policy_server/server/robot/context/policy.h"
#include "policy_server/server/rollout/bundle_library.h"
#include "policy_server/server/shadow/shadows.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::server {

// Any thread. Errors are those of bundle::LoadBundle, and PermissionDenied for one that is not
// signed by one of the keys, if there are any.
class BundleLoader {
 public:
  // `keys`: paths of those who may sign. `clock` and `inspections` are not owned and outlive this
  // and all policies.
  BundleLoader(std::vector<std::string> keys, const Clock* clock, inspect::Containment containment,
               inspect::InspectionPool* inspections)
      : keys_(std::move(keys)),
        clock_(clock),
        containment_(std::move(containment)),
        inspections_(inspections) {}

  // Reads the keys (anew). An error: the old ones count.
  absl::Status ReadKeys() ABSL_LOCKS_EXCLUDED(mu_);
  // The key that signed the bundle of that id; empty if none need have.
  absl::StatusOr<std::string> SignedBy(const std::string& dir, const std::string& id) const
      ABSL_LOCKS_EXCLUDED(mu_);
  // As PolicySource::Load.
  absl::StatusOr<pipeline::Policy> LoadPolicy(const std::string& dir, const std::string& name);
  absl::StatusOr<rollout::LoadedBundle> LoadPushed(const std::string& dir);
  // DataLoss: it is not the bundle of that id.
  absl::StatusOr<shadow::ShadowPolicy> LoadShadow(const std::string& dir, const std::string& id);

 private:
  absl::StatusOr<bundle::Bundle> LoadBundle(const std::string& dir);
  absl::StatusOr<bundle::Bundle> LoadSignedBundle(const std::string& dir);

  const std::vector<std::string> keys_;
  const Clock* const clock_;
  const inspect::Containment containment_;
  inspect::InspectionPool* const inspections_;
  mutable Mutex mu_;
  bundle::SignerKeys signers_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_BUNDLE_LOADER_H_
