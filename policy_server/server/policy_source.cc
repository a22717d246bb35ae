#include "policy_server/server/policy_source.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle_keep.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::server {

PolicySource::Source PolicySource::SourceOf(const bundle::InventoryRobot& robot) const {
  return {robot.bundle, options_.activated ? options_.activated(robot) : ""};
}

PolicySource::Policies PolicySource::FindAll(const bundle::Inventory& inventory,
                                             const std::set<std::string>* only) {
  Policies policies;
  for (const bundle::InventoryRobot& robot : inventory.robots) {
    const Source source = SourceOf(robot);
    if ((only != nullptr && !only->contains(robot.id)) || policies.contains(source)) continue;
    policies.emplace(source, Find(source.first, source.second));
  }
  return policies;
}

absl::StatusOr<pipeline::Policy> PolicySource::Find(const std::string& name,
                                                    const std::string& id) {
  if (id.empty()) return LoadFromDirectory(name);
  if (const auto known = loaded_.find(id); known != loaded_.end()) return known->second;
  RIPS_ASSIGN_OR_RETURN(const std::string path, bundle::KeptBundlePath(options_.bundles_dir, id));
  absl::StatusOr<pipeline::Policy> policy = load_(path, name);
  if (policy.ok() && policy->bundle_id != id) {
    policy = absl::DataLossError("its copy was changed");
  }
  if (policy.ok()) {
    loaded_.emplace(id, *policy);
  } else {
    LogError("bundle refused", {{"bundle", path}, {"reason", policy.status().message()}});
  }
  return policy;
}

absl::StatusOr<pipeline::Policy> PolicySource::LoadFromDirectory(const std::string& name) {
  const std::string dir = absl::StrCat(options_.bundles_source, "/", name);
  absl::StatusOr<pipeline::Policy> policy = load_(dir, name);
  if (!policy.ok()) {
    LogError("bundle refused", {{"bundle", dir}, {"reason", policy.status().message()}});
  } else if (const absl::Status kept =
                 bundle::KeepBundle(dir, policy->bundle_id, options_.bundles_dir);
             !kept.ok()) {
    LogWarning(
        "cannot keep a copy of the bundle; if the next start rejects it, its robots stay at "
        "their level",
        {{"bundle", dir}, {"reason", kept.message()}});
  }
  return policy;
}

absl::StatusOr<pipeline::Policy> PolicySource::FindLastGood(const std::string& id) {
  RIPS_ASSIGN_OR_RETURN(const std::string path, bundle::KeptBundlePath(options_.bundles_dir, id));
  absl::StatusOr<pipeline::Policy> policy = load_(path, "");
  if (policy.ok() && policy->bundle_id != id) {
    return absl::DataLossError("its copy was changed");
  }
  return policy;
}

void PolicySource::ForgetUnused(std::set<std::string> in_use) {
  if (options_.needed) in_use.merge(options_.needed());
  absl::erase_if(loaded_, [&](const auto& each) { return !in_use.contains(each.first); });
  bundle::ForgetBundles(options_.bundles_dir, in_use);
}

}  // namespace rips::server
