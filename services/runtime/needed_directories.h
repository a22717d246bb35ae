// For --check-config: the directories that a daemon does not make itself, and warnings.
#ifndef RIPS_SERVICES_RUNTIME_NEEDED_DIRECTORIES_H_
#define RIPS_SERVICES_RUNTIME_NEEDED_DIRECTORIES_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips {

struct NeededDirectory {
  std::string key;   // of the configuration: `store.path`
  std::string path;  // absolute
};

// The directory that holds `path`, which is absolute: `/a` of `/a/b` and `/a/b/`, `/` of `/a`.
std::string ParentDirectory(absl::string_view path);

// InvalidArgument with a line for each of `needed` that does not exist or is no directory. One that
// this user may not look for counts as there. `file` is the name used in messages.
absl::Status CheckDirectories(absl::string_view file, const std::vector<NeededDirectory>& needed);

// `warning: TEXT` a line, on standard error; empty ones are left out.
void PrintWarnings(const std::vector<std::string>& warnings);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_NEEDED_DIRECTORIES_H_
