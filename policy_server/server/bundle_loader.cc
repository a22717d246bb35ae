#include "policy_server/server/bundle_loader.h"

#include <malloc.h>

#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "policy_server/server/pooled_inspector.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::server {

absl::Status BundleLoader::ReadKeys() {
  RIPS_ASSIGN_OR_RETURN(bundle::SignerKeys signers, bundle::SignerKeys::Load(keys_));
  MutexLock lock(&mu_);
  signers_ = std::move(signers);
  return absl::OkStatus();
}

absl::StatusOr<std::string> BundleLoader::SignedBy(const std::string& dir,
                                                   const std::string& id) const {
  if (keys_.empty()) return "";
  const absl::StatusOr<std::string> signature = bundle::ReadSignature(dir);
  if (!signature.ok()) return absl::PermissionDeniedError(signature.status().message());
  MutexLock lock(&mu_);
  return signers_.Verify(id, *signature);
}

absl::StatusOr<bundle::Bundle> BundleLoader::LoadBundle(const std::string& dir) {
  return bundle::LoadBundle(dir, clock_, {.plugin = {.contain = containment_}});
}

absl::StatusOr<bundle::Bundle> BundleLoader::LoadSignedBundle(const std::string& dir) {
  if (!keys_.empty()) {
    // Before anything of it is compiled or run.
    RIPS_ASSIGN_OR_RETURN(const std::string id, bundle::BundleIdOf(dir));
    RIPS_RETURN_IF_ERROR(SignedBy(dir, id).status());
  }
  RIPS_ASSIGN_OR_RETURN(bundle::Bundle loaded, LoadBundle(dir));
  RIPS_RETURN_IF_ERROR(SignedBy(dir, loaded.id).status());
  return loaded;
}

absl::StatusOr<pipeline::Policy> BundleLoader::LoadPolicy(const std::string& dir,
                                                          const std::string& name) {
  RIPS_ASSIGN_OR_RETURN(bundle::Bundle loaded,
                        name.empty() ? LoadBundle(dir) : LoadSignedBundle(dir));
  if (!name.empty() && loaded.manifest.name != name) {
    return absl::InvalidArgumentError(absl::StrCat("its manifest calls it `", loaded.manifest.name,
                                                   "`; the inventory wants `", name, "`"));
  }
  if (!loaded.warnings.empty()) {
    // Rule text stays out of logs; `ripsctl rules check` shows it to its author.
    LogWarning("rule compiler warnings", {{"bundle", dir}, {"warnings", loaded.warnings}});
  }
  LogInfo("bundle loaded", {{"bundle", loaded.manifest.name},
                            {"id", loaded.id},
                            {"rules", loaded.program->rules().rules.size()}});
  std::shared_ptr<pipeline::Inspector> inspector;
  if (loaded.inspections != nullptr) {
    inspector = std::make_shared<PooledInspector>(inspections_, loaded.inspections);
  }
  return pipeline::Policy{.program = loaded.program,
                          .bundle_id = loaded.id,
                          .start_level = loaded.start_level,
                          .soft_hold_ns = absl::ToInt64Nanoseconds(loaded.manifest.soft_hold),
                          .two_person = loaded.manifest.two_person,
                          .inspector = std::move(inspector),
                          .interest = pipeline::MakeInterest(*loaded.program),
                          .payload_limits = loaded.manifest.payload_limits};
}

absl::StatusOr<rollout::LoadedBundle> BundleLoader::LoadPushed(const std::string& dir) {
  rollout::LoadedBundle out;
  {
    RIPS_ASSIGN_OR_RETURN(const bundle::Bundle loaded, LoadSignedBundle(dir));
    out = {.id = loaded.id, .name = loaded.manifest.name, .warnings = loaded.warnings};
  }
  // What compiling took is given back: the bundle may never be activated.
  malloc_trim(0);
  return out;
}

absl::StatusOr<shadow::ShadowPolicy> BundleLoader::LoadShadow(const std::string& dir,
                                                              const std::string& id) {
  RIPS_ASSIGN_OR_RETURN(const bundle::Bundle loaded, LoadSignedBundle(dir));
  if (loaded.id != id) return absl::DataLossError("its copy was changed");
  return shadow::PolicyOf(loaded);
}

}  // namespace rips::server
