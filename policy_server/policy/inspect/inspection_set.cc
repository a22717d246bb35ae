#include "policy_server/policy/inspect/inspection_set.h"

#include <string>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/inspect/rule_image.h"
#include "policy_server/policy/inspect/scanner_process.h"
#include "services/base/status_macros.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
// What one inspection asks: a file of the image, by its place there, or a plugin.
using Asked = std::variant<uint32_t, PluginSpec>;

ScannerOptions ScannerOptionsOf(const InspectOptions& options) {
  return {.payload_bytes_max = options.payload_bytes_max,
          .scan_time = options.scan_time,
          .restart = options.plugin.restart,
          .process = options.scanner,
          .contain = options.plugin.contain};
}

class LoadedSession final : public Session {
 public:
  // `image` is null if there is no YARA file.
  LoadedSession(const std::vector<Asked>& asked, const std::shared_ptr<const RuleImage>& image,
                const InspectOptions& options, const Clock* clock)
      : payload_bytes_max_(options.payload_bytes_max) {
    for (const Asked& each : asked) {
      Part& part = parts_.emplace_back();
      if (const auto* spec = std::get_if<PluginSpec>(&each)) {
        part.plugin = std::make_unique<Plugin>(*spec, options.plugin, clock);
        part.plugin->Warm();
      } else {
        part.file = std::get<uint32_t>(each);
      }
    }
    if (image != nullptr) {
      scanner_ = std::make_unique<ScannerProcess>(image, ScannerOptionsOf(options), clock);
      // If it does not come up now, it is tried again, and told, when it is needed.
      scanner_->Start().IgnoreError();
    }
    for (Part& part : parts_) {
      if (part.plugin != nullptr) part.plugin->AwaitWarm();
    }
    TakeStartNs();
  }

  Verdict Inspect(uint32_t index, const Message& message) override {
    if (index >= parts_.size() || !message.available) return Verdict::kUnscanned;
    const Part& part = parts_[index];
    const absl::string_view scanned = message.payload.substr(0, payload_bytes_max_);
    const Verdict verdict = part.plugin != nullptr
                                ? part.plugin->Ask(message)
                                : scanner_->Scan(part.file, message.robot, scanned);
    const size_t seen = part.plugin != nullptr ? message.payload.size() : scanned.size();
    return verdict == Verdict::kNo && seen < message.size_bytes ? Verdict::kUnscanned : verdict;
  }

  int64_t TakeStartNs() override {
    int64_t sum_ns = scanner_ == nullptr ? 0 : scanner_->TakeStartNs();
    for (Part& part : parts_) sum_ns += part.plugin == nullptr ? 0 : part.plugin->TakeStartNs();
    return sum_ns;
  }

 private:
  // A file of the scanner, or a plugin.
  struct Part {
    uint32_t file = 0;
    std::unique_ptr<Plugin> plugin;
  };

  const size_t payload_bytes_max_;
  std::unique_ptr<ScannerProcess> scanner_;
  std::vector<Part> parts_;
};

class LoadedSet final : public InspectionSet {
 public:
  LoadedSet(std::vector<Asked> asked, std::shared_ptr<const RuleImage> image,
            InspectOptions options, const Clock* clock)
      : asked_(std::move(asked)),
        image_(std::move(image)),
        options_(std::move(options)),
        clock_(clock) {}

  size_t size() const override { return asked_.size(); }
  std::unique_ptr<Session> NewSession() const override {
    return std::make_unique<LoadedSession>(asked_, image_, options_, clock_);
  }

 private:
  const std::vector<Asked> asked_;
  const std::shared_ptr<const RuleImage> image_;
  const InspectOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
};

// Adds the YARA file of `inspection`, if it is one, to `yara`.
absl::StatusOr<Asked> LoadOne(const lang::Inspection& inspection, CheckedFiles& files,
                              std::vector<std::shared_ptr<const YaraRules>>& yara) {
  if (inspection.kind == lang::Inspection::Kind::kPayload) {
    RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const YaraRules> rules, files.Rules(inspection));
    yara.push_back(std::move(rules));
    return Asked(static_cast<uint32_t>(yara.size() - 1));
  }
  RIPS_ASSIGN_OR_RETURN(std::string path, files.Program(inspection));
  std::string root = files.ReadableRoot(path);
  return Asked(PluginSpec{.id = inspection.name, .path = std::move(path), .root = std::move(root)});
}

// The image of `yara`, null if that is empty, and a scanner that could be started with it.
absl::StatusOr<std::shared_ptr<const RuleImage>> LoadImage(
    const std::vector<std::shared_ptr<const YaraRules>>& yara, const InspectOptions& options,
    const Clock* clock) {
  if (yara.empty()) return std::shared_ptr<const RuleImage>();
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const RuleImage> image, RuleImage::Create(yara));
  RIPS_RETURN_IF_ERROR(ScannerProcess(image, ScannerOptionsOf(options), clock).Start());
  return image;
}

absl::Status Probe(std::vector<Asked>& asked, const InspectOptions& options, const Clock& clock) {
  std::vector<PluginSpec> plugins;
  for (const Asked& each : asked) {
    if (const auto* plugin = std::get_if<PluginSpec>(&each)) plugins.push_back(*plugin);
  }
  RIPS_RETURN_IF_ERROR(ProbePlugins(plugins, options.plugin, clock));
  size_t probed = 0;
  for (Asked& each : asked) {
    if (auto* plugin = std::get_if<PluginSpec>(&each)) *plugin = std::move(plugins[probed++]);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::shared_ptr<const InspectionSet>> LoadInspections(
    const std::vector<lang::Inspection>& inspections, CheckedFiles& files,
    const InspectOptions& options, const Clock* clock) {
  if (inspections.size() > kInspectionsMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(inspections.size(), " inspections exceed limit ", kInspectionsMax));
  }
  std::vector<Asked> asked;
  std::vector<std::shared_ptr<const YaraRules>> yara;
  std::vector<std::string> problems;
  for (const lang::Inspection& inspection : inspections) {
    absl::StatusOr<Asked> loaded = LoadOne(inspection, files, yara);
    if (loaded.ok()) {
      asked.push_back(*std::move(loaded));
    } else {
      problems.push_back(std::string(loaded.status().message()));
    }
  }
  if (!problems.empty()) return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
  RIPS_RETURN_IF_ERROR(Probe(asked, options, *clock));
  RIPS_ASSIGN_OR_RETURN(auto image, LoadImage(yara, options, clock));
  return std::make_shared<LoadedSet>(std::move(asked), std::move(image), options, clock);
}

}  // namespace rips::inspect
