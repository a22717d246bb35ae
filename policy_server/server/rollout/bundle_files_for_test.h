// Bundles on disk, for tests.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_FILES_FOR_TEST_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_FILES_FOR_TEST_H_

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/server/rollout/bundle_library.h"
#include "services/runtime/real_clock.h"

namespace rips::rollout {

// Writes DIR/manifest.yaml and DIR/r.rul; `rules` follows the levels.
inline void WriteBundle(const std::string& dir, const std::string& name,
                        const std::string& rules = "",
                        const std::string& levels = "DEFAULT, ALERT, HALT") {
  std::filesystem::create_directories(dir);
  std::ofstream(dir + "/manifest.yaml")
      << "name: " << name << "\nrules: [r.rul]\nlevels: [" << levels << "]\n";
  std::string declared = levels;
  for (size_t at = 0; (at = declared.find(", ", at)) != std::string::npos;) {
    declared.replace(at, 2, ";\n  ");
  }
  std::ofstream(dir + "/r.rul") << "levels:\n  " << declared << ";\n" << rules;
}

inline absl::StatusOr<LoadedBundle> LoadForTest(const std::string& dir) {
  static const RealClock clock;
  const absl::StatusOr<bundle::Bundle> loaded = bundle::LoadBundle(dir, &clock);
  if (!loaded.ok()) return loaded.status();
  return LoadedBundle{
      .id = loaded->id, .name = loaded->manifest.name, .warnings = loaded->warnings};
}

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_FILES_FOR_TEST_H_
