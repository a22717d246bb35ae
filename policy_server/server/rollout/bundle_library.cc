#include "policy_server/server/rollout/bundle_library.h"

#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "policy_server/policy/bundle/bundle_keep.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/policy/bundle/manifest.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::rollout {
namespace {

namespace fs = std::filesystem;

constexpr absl::string_view kIdPrefix = "sha256:";
constexpr size_t kIdDigits = 64;
// Not one of those that ForgetBundles removes.
constexpr char kArriving[] = ".pushed";

bool IsHex(absl::string_view text) {
  return text.find_first_not_of("0123456789abcdef") == absl::string_view::npos;
}

int64_t StoredUnixNs(const std::string& path) {
  struct stat about = {};
  if (stat(path.c_str(), &about) != 0) return 0;
  return about.st_mtim.tv_sec * kNanosPerSecond + about.st_mtim.tv_nsec;
}

// Removes a directory when it goes.
class Removed {
 public:
  explicit Removed(std::string path) : path_(std::move(path)) { Remove(); }
  ~Removed() { Remove(); }
  Removed(const Removed&) = delete;
  Removed& operator=(const Removed&) = delete;

 private:
  void Remove() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  const std::string path_;
};

}  // namespace

BundleLibrary::BundleLibrary(std::string directory, Load load, SignedBy signed_by)
    : directory_(std::move(directory)), load_(std::move(load)), signed_by_(std::move(signed_by)) {}

absl::StatusOr<BundleLibrary::Added> BundleLibrary::Add(absl::string_view archive) {
  std::error_code error;
  fs::create_directories(directory_, error);
  if (error) {
    return absl::UnavailableError(absl::StrCat("making `", directory_, "`: ", error.message()));
  }
  const std::string arriving = absl::StrCat(directory_, "/", kArriving);
  const Removed removed(arriving);
  RIPS_RETURN_IF_ERROR(bundle::UnpackBundle(archive, arriving));
  const absl::StatusOr<LoadedBundle> loaded = load_(arriving);
  // The author knows the bundle as it is in the directory that was pushed.
  const auto shown = [&arriving](absl::string_view text) {
    return absl::StrReplaceAll(text, {{absl::StrCat("bundle `", arriving, "`: "), ""},
                                      {absl::StrCat(arriving, "/"), ""},
                                      {arriving, "DIR"}});
  };
  if (!loaded.ok()) {
    return absl::Status(loaded.status().code(),
                        absl::StrCat("the bundle is refused: ", shown(loaded.status().message())));
  }
  RIPS_ASSIGN_OR_RETURN(const std::string path, bundle::KeptBundlePath(directory_, loaded->id));
  const bool known = fs::exists(path, error);
  if (known) RIPS_RETURN_IF_ERROR(KeepSignature(path, arriving, loaded->id));
  RIPS_RETURN_IF_ERROR(bundle::KeepBundle(arriving, loaded->id, directory_));
  return Added{
      .bundle = Describe(path, loaded->id), .warnings = shown(loaded->warnings), .known = known};
}

absl::Status BundleLibrary::KeepSignature(const std::string& kept, const std::string& arriving,
                                          const std::string& id) const {
  const absl::StatusOr<std::string> key = signed_by_(arriving, id);
  const absl::StatusOr<std::string> signature = bundle::ReadSignature(kept);
  // One that was verified may take the place of another one.
  if ((key.ok() && !key->empty()) || !signature.ok() || signature->empty()) return absl::OkStatus();
  return WriteFileAtomically(absl::StrCat(arriving, "/", bundle::kSignatureName), *signature, 0640);
}

KeptBundle BundleLibrary::Describe(const std::string& path, const std::string& id) const {
  KeptBundle kept{.id = id, .stored_unix_ns = StoredUnixNs(path)};
  const absl::StatusOr<std::string> text =
      ReadFile(absl::StrCat(path, "/", bundle::kManifestName), bundle::kManifestBytesMax);
  const absl::StatusOr<bundle::Manifest> manifest =
      text.ok() ? bundle::ParseManifest(bundle::kManifestName, *text)
                : absl::StatusOr<bundle::Manifest>(text.status());
  if (!manifest.ok()) {
    kept.problem = absl::StrCat("its copy is damaged: ", manifest.status().message());
    return kept;
  }
  kept.name = manifest->name;
  absl::StatusOr<std::string> key = signed_by_(path, id);
  if (key.ok()) {
    kept.signed_by = *std::move(key);
  } else {
    kept.problem = std::string(key.status().message());
  }
  return kept;
}

absl::StatusOr<std::vector<KeptBundle>> BundleLibrary::List() const {
  std::vector<KeptBundle> bundles;
  std::error_code error;
  if (!fs::exists(directory_, error)) return bundles;
  fs::directory_iterator it(directory_, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    const std::string digits = it->path().filename().string();
    if (digits.size() != kIdDigits || !IsHex(digits)) continue;
    bundles.push_back(Describe(it->path().string(), absl::StrCat(kIdPrefix, digits)));
  }
  if (error) {
    return absl::UnavailableError(absl::StrCat("reading `", directory_, "`: ", error.message()));
  }
  std::sort(bundles.begin(), bundles.end(), [](const KeptBundle& a, const KeptBundle& b) {
    return a.stored_unix_ns != b.stored_unix_ns ? a.stored_unix_ns > b.stored_unix_ns : a.id < b.id;
  });
  return bundles;
}

absl::StatusOr<KeptBundle> BundleLibrary::Find(absl::string_view id) const {
  absl::string_view digits = absl::StripPrefix(id, kIdPrefix);
  if (digits.size() < kIdDigitsMin || digits.size() > kIdDigits || !IsHex(digits)) {
    return absl::InvalidArgumentError(
        absl::StrCat("a bundle is named by `sha256:` and its 64 hex digits, or by at least the "
                     "first ",
                     kIdDigitsMin, " of them; `ripsctl rules list` shows them"));
  }
  RIPS_ASSIGN_OR_RETURN(const std::vector<KeptBundle> all, List());
  const KeptBundle* found = nullptr;
  for (const KeptBundle& each : all) {
    if (!absl::StartsWith(absl::StripPrefix(each.id, kIdPrefix), digits)) continue;
    if (found != nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat("the ids of several bundles begin with ", digits, "; give more digits"));
    }
    found = &each;
  }
  if (found == nullptr) {
    return absl::NotFoundError(absl::StrCat("the server keeps no bundle ", digits,
                                            "; `ripsctl rules push DIR` brings one"));
  }
  return *found;
}

}  // namespace rips::rollout
