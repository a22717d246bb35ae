#include "policy_server/ripsctl/rules/rule_input.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/limits.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::ripsctl {
namespace {

// In diagnostics.
constexpr absl::string_view kStandardInputName = "<stdin>";

absl::StatusOr<std::string> ReadStandardInput(std::istream* in) {
  if (in == nullptr) return "";
  std::string text(lang::kFileBytesMax + 1, '\0');
  in->read(text.data(), static_cast<std::streamsize>(text.size()));
  if (in->bad()) return absl::UnavailableError("cannot read standard input");
  text.resize(static_cast<size_t>(in->gcount()));
  if (text.size() > lang::kFileBytesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("standard input has more than ", lang::kFileBytesMax, " bytes"));
  }
  return text;
}

}  // namespace

absl::StatusOr<std::vector<lang::SourceFile>> ReadRuleFiles(Env& env,
                                                            const std::vector<std::string>& paths) {
  if (std::count(paths.begin(), paths.end(), kStandardInput) > 1) {
    return absl::InvalidArgumentError("standard input (`-`) can be read only once");
  }
  std::vector<lang::SourceFile> files;
  for (const std::string& path : paths) {
    if (path == kStandardInput) {
      RIPS_ASSIGN_OR_RETURN(std::string text, ReadStandardInput(env.in));
      files.push_back({.path = std::string(kStandardInputName), .text = std::move(text)});
    } else {
      RIPS_ASSIGN_OR_RETURN(std::string text, ReadFile(path, lang::kFileBytesMax));
      files.push_back({.path = path, .text = std::move(text)});
    }
  }
  return files;
}

}  // namespace rips::ripsctl
