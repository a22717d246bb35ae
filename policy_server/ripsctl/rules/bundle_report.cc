#include "policy_server/ripsctl/rules/bundle_report.h"

#include <nlohmann/json.hpp>
#include <string>

#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/ripsctl/cli/printer.h"

namespace rips::ripsctl {
namespace {

// `text` may have several lines.
void PrintProblem(absl::string_view severity, absl::string_view text, TextStream out) {
  out << severity << ": " << Lines{text} << "\n";
}

}  // namespace

void PrintBundleCheck(const bundle::BundleCheck& check, TextStream out) {
  out << Lines{lang::RenderText(check.files, check.diagnostics)};
  for (const std::string& text : check.problems) PrintProblem("error", text, out);
  for (const std::string& text : check.warnings) PrintProblem("warning", text, out);
}

Json BundleCheckJson(const bundle::BundleCheck& check) {
  Json json = Json::parse(lang::RenderJson(check.files, check.diagnostics));
  json["bundle"] = {{"name", check.name},
                    {"id", check.id},
                    {"ok", check.ok()},
                    {"problems", check.problems},
                    {"warnings", check.warnings}};
  return json;
}

}  // namespace rips::ripsctl
