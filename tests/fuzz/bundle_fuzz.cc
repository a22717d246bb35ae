// A bundle that an administrator's key pushes: whatever it is, nothing is written outside its
// directory, and nothing is left of one that is refused.
#include <stdlib.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "services/base/check.h"

namespace {

namespace fs = std::filesystem;

// In memory, if the machine has such a place: each input is a few files.
fs::path Place() {
  std::string name = (fs::exists("/dev/shm") ? fs::path("/dev/shm") : fs::temp_directory_path()) /
                     "rips-bundle-fuzz-XXXXXX";
  RIPS_CHECK(mkdtemp(name.data()) != nullptr, "mkdtemp");
  return name;
}

size_t CountIn(const fs::path& directory) {
  size_t count = 0;
  for ([[maybe_unused]] const auto& each : fs::directory_iterator(directory)) ++count;
  return count;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const fs::path place = [] {
    const fs::path made = Place();
    static const std::string at_exit = made.string();
    atexit([] { fs::remove_all(at_exit); });
    return made;
  }();
  const fs::path bundle = place / "bundle";
  const absl::string_view archive(reinterpret_cast<const char*>(data), size);
  const bool taken = rips::bundle::UnpackBundle(archive, bundle).ok();
  RIPS_CHECK(CountIn(place) == (taken ? 1u : 0u), "something is left, or beside the bundle");
  if (!taken) return 0;
  RIPS_CHECK(rips::bundle::PackBundle(bundle).ok(), "what was taken cannot be packed");
  fs::remove_all(bundle);
  return 0;
}
