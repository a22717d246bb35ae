#include "policy_server/ripsctl/reference/command_tree.h"

#include <CLI/CLI.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"

namespace rips::ripsctl {
namespace {

// Of `text|json`, or of the limits `{text,json}`.
std::vector<std::string> ChoicesOf(absl::string_view value, absl::string_view limits) {
  if (absl::ConsumePrefix(&limits, "{") && absl::ConsumeSuffix(&limits, "}")) {
    return absl::StrSplit(limits, ',');
  }
  std::vector<std::string> choices = absl::StrSplit(value, '|');
  return choices.size() > 1 ? choices : std::vector<std::string>();
}

FlagDoc DescribeOption(const CLI::Option& option) {
  FlagDoc flag;
  if (option.get_positional()) flag.names.push_back(option.get_name(/*positional=*/true));
  for (const std::string& name : option.get_snames()) flag.names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) flag.names.push_back("--" + name);
  if (option.get_type_size() != 0) {
    const std::pair<std::string, std::string> type =
        absl::StrSplit(option.get_type_name(), absl::MaxSplits(':', 1));
    flag.value = type.first;
    flag.choices = ChoicesOf(type.first, type.second);
    if (flag.choices.empty()) flag.limits = type.second;
    flag.fallback = option.get_default_str();
  }
  flag.text = option.get_description();
  flag.required = option.get_required();
  flag.repeated = option.get_expected_max() == CLI::detail::expected_max_vector_size;
  return flag;
}

CommandDoc Describe(const CLI::App& app, const std::string& words) {
  CommandDoc doc;
  doc.words = words;
  doc.synopsis = app.get_description();
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;
    (option->get_positional() ? doc.arguments : doc.flags).push_back(DescribeOption(*option));
  }
  for (const CLI::App* each : app.get_subcommands([](const CLI::App*) { return true; })) {
    if (each->get_group().empty()) continue;
    const std::string& name = each->get_name();
    doc.commands.push_back(Describe(*each, words.empty() ? name : absl::StrCat(words, " ", name)));
  }
  return doc;
}

}  // namespace

CommandDoc DescribeCommands(const CLI::App& app) {
  const CLI::App* root = &app;
  while (root->get_parent() != nullptr) root = root->get_parent();
  return Describe(*root, "");
}

}  // namespace rips::ripsctl
