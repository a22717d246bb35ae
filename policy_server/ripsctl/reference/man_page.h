// The manual page of ripsctl, in roff.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_MAN_PAGE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_MAN_PAGE_H_

#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/reference/command_tree.h"

namespace rips::ripsctl {

// ripsctl(1), with a section for each command, for the macros of man(7). The same tree and version
// give the same bytes.
std::string ManPage(const CommandDoc& program, absl::string_view version);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_MAN_PAGE_H_
