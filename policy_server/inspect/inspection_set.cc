#include "policy_server/inspect/inspection_set.h"

#include <string>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/inspect/yara_scanner.h"
#include "services/base/status_macros.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
// What one inspection asks.
using Asked = std::variant<std::shared_ptr<const YaraRules>, PluginSpec>;

class LoadedSession final : public Session {
 public:
  LoadedSession(const std::vector<Asked>& asked, const InspectOptions& options, const Clock* clock)
      : payload_bytes_max_(options.payload_bytes_max), scan_time_(options.scan_time) {
    for (const Asked& each : asked) {
      Part part;
      if (const auto* rules = std::get_if<std::shared_ptr<const YaraRules>>(&each)) {
        part.rules = *rules;
        part.scanner = std::make_unique<YaraScanner>(*part.rules);
      } else {
        part.plugin = std::make_unique<Plugin>(std::get<PluginSpec>(each), options.plugin, clock);
        part.plugin->Warm();
      }
      parts_.push_back(std::move(part));
    }
  }

  Verdict Inspect(uint32_t index, const Message& message) override {
    if (index >= parts_.size() || !message.available) return Verdict::kUnscanned;
    Part& part = parts_[index];
    if (part.plugin != nullptr) return part.plugin->Ask(message);
    return part.scanner->Scan(message.payload.substr(0, payload_bytes_max_), scan_time_);
  }

 private:
  // Rules with their scanner, or a plugin.
  struct Part {
    std::shared_ptr<const YaraRules> rules;
    std::unique_ptr<YaraScanner> scanner;
    std::unique_ptr<Plugin> plugin;
  };

  const size_t payload_bytes_max_;
  const absl::Duration scan_time_;
  std::vector<Part> parts_;
};

class LoadedSet final : public InspectionSet {
 public:
  LoadedSet(std::vector<Asked> asked, InspectOptions options, const Clock* clock)
      : asked_(std::move(asked)), options_(std::move(options)), clock_(clock) {}

  size_t size() const override { return asked_.size(); }
  std::unique_ptr<Session> NewSession() const override {
    return std::make_unique<LoadedSession>(asked_, options_, clock_);
  }

 private:
  const std::vector<Asked> asked_;
  const InspectOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
};

absl::StatusOr<Asked> LoadOne(const lang::Inspection& inspection, CheckedFiles& files) {
  if (inspection.kind == lang::Inspection::Kind::kPayload) {
    RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const YaraRules> rules, files.Rules(inspection));
    return Asked(std::move(rules));
  }
  RIPS_ASSIGN_OR_RETURN(std::string path, files.Program(inspection));
  return Asked(PluginSpec{.id = inspection.name, .path = std::move(path)});
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
  std::vector<std::string> problems;
  for (const lang::Inspection& inspection : inspections) {
    absl::StatusOr<Asked> loaded = LoadOne(inspection, files);
    if (loaded.ok()) {
      asked.push_back(*std::move(loaded));
    } else {
      problems.push_back(std::string(loaded.status().message()));
    }
  }
  if (!problems.empty()) return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
  RIPS_RETURN_IF_ERROR(Probe(asked, options, *clock));
  return std::make_shared<LoadedSet>(std::move(asked), options, clock);
}

}  // namespace rips::inspect
