// What there is to say of a bundle before a server gets it.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_BUNDLE_REPORT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_BUNDLE_REPORT_H_

#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/text_stream.h"

namespace rips::ripsctl {

// Diagnostics of the rules with their places, then problems and warnings, one line each.
void PrintBundleCheck(const bundle::BundleCheck& check, TextStream out);
// lang::RenderJson of the rule files, and
// "bundle":{"name","id","ok","problems":[..],"warnings":[..]}; a refused one has no id.
Json BundleCheckJson(const bundle::BundleCheck& check);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_BUNDLE_REPORT_H_
