#include "services/runtime/config_reader.h"

#include <algorithm>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/check.h"
#include "services/runtime/config_tree.h"

namespace rips {
namespace {

// Digits without leading zeros, an optional minus sign if `negative`.
bool ParseWhole(absl::string_view text, int64_t* value) {
  absl::string_view digits = text;
  if (!digits.empty() && digits[0] == '-') digits.remove_prefix(1);
  if (digits.empty() || digits.find_first_not_of("0123456789") != absl::string_view::npos) {
    return false;
  }
  if (digits.size() > 1 && digits[0] == '0') return false;
  return absl::SimpleAtoi(text, value);
}

template <typename Unit>
using Units = std::vector<std::pair<absl::string_view, Unit>>;

// Largest first.
const Units<absl::Duration>& DurationUnits() {
  static const auto& units = *new Units<absl::Duration>{
      {"d", absl::Hours(24)},  {"h", absl::Hours(1)},         {"min", absl::Minutes(1)},
      {"s", absl::Seconds(1)}, {"ms", absl::Milliseconds(1)}, {"us", absl::Microseconds(1)}};
  return units;
}

const Units<int64_t>& SizeUnits() {
  static const auto& units = *new Units<int64_t>{
      {"GiB", int64_t{1} << 30}, {"MiB", int64_t{1} << 20}, {"KiB", int64_t{1} << 10}, {"B", 1}};
  return units;
}

// Splits `15s` into 15 and `s`; false if there is no number.
bool SplitUnit(absl::string_view text, int64_t* number, absl::string_view* unit) {
  const size_t end = std::min(text.find_first_not_of("0123456789"), text.size());
  *unit = text.substr(end);
  return ParseWhole(text.substr(0, end), number);
}

bool HasControlCharacter(absl::string_view text) {
  return std::any_of(text.begin(), text.end(),
                     [](char c) { return static_cast<unsigned char>(c) < 0x20 || c == 0x7f; });
}

absl::string_view KindName(const ConfigNode& node) {
  switch (node.kind) {
    case ConfigNode::Kind::kNull:
      return "nothing";
    case ConfigNode::Kind::kScalar:
      return "a single value";
    case ConfigNode::Kind::kList:
      return "a list";
    case ConfigNode::Kind::kMap:
      return "a mapping";
  }
  return "";
}

}  // namespace

absl::StatusOr<absl::Duration> ParseConfigDuration(absl::string_view text) {
  constexpr int64_t kDaysMax = 36500;
  int64_t number = 0;
  absl::string_view unit;
  if (SplitUnit(text, &number, &unit)) {
    for (const auto& [name, length] : DurationUnits()) {
      if (unit != name) continue;
      if (absl::Hours(24) * kDaysMax / length < static_cast<double>(number)) break;
      return length * number;
    }
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "`", text,
      "` is not a duration; write a number and a unit, such as `500ms`, `15s`, `10min`, `2h`"));
}

std::string FormatConfigDuration(absl::Duration duration) {
  if (duration == absl::ZeroDuration()) return "0s";
  if (duration == absl::InfiniteDuration()) return "infinite";
  for (const auto& [name, length] : DurationUnits()) {
    if (duration % length == absl::ZeroDuration()) return absl::StrCat(duration / length, name);
  }
  return absl::StrCat(absl::ToInt64Nanoseconds(duration), "ns");
}

absl::StatusOr<ByteSize> ParseByteSize(absl::string_view text) {
  int64_t number = 0;
  absl::string_view unit;
  if (SplitUnit(text, &number, &unit)) {
    for (const auto& [name, bytes] : SizeUnits()) {
      if (unit != name) continue;
      if (number > std::numeric_limits<int64_t>::max() / bytes) break;
      return ByteSize{number * bytes};
    }
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "`", text, "` is not a size; write a number and a unit, such as `512B`, `64KiB`, `1MiB`"));
}

std::string FormatByteSize(ByteSize size) {
  for (const auto& [name, bytes] : SizeUnits()) {
    if (size.bytes != 0 && size.bytes % bytes == 0) return absl::StrCat(size.bytes / bytes, name);
  }
  return absl::StrCat(size.bytes, "B");
}

std::string ConfigSection::PathOf(absl::string_view key) const {
  return path_.empty() ? std::string(key) : absl::StrCat(path_, ".", key);
}

bool ConfigSection::Has(absl::string_view key) const {
  return node_ != nullptr && node_->Find(key) != nullptr;
}

std::vector<std::string> ConfigSection::Keys() const {
  std::vector<std::string> keys;
  if (node_ == nullptr) return keys;
  for (const ConfigNode::Entry& entry : node_->entries) keys.push_back(entry.key);
  return keys;
}

void ConfigSection::AddSetting(absl::string_view key, absl::string_view value) const {
  tree_->AddSetting(PathOf(key), value, Has(key) ? LineOf(key) : 0);
}

int ConfigSection::LineOf(absl::string_view key) const {
  if (node_ == nullptr) return 0;
  const ConfigNode::Entry* entry = node_->Find(key);
  return (entry == nullptr ? node_->place : entry->value->place).line + 1;
}

void ConfigSection::Problem(absl::string_view key, absl::string_view message) const {
  if (node_ == nullptr) return;
  const ConfigNode::Entry* entry = node_->Find(key);
  tree_->AddProblem(entry == nullptr ? node_->place : entry->value->place, message);
}

ConfigNode* ConfigSection::Find(absl::string_view key, bool required) const {
  if (node_ == nullptr) return nullptr;
  if (std::find(node_->asked.begin(), node_->asked.end(), key) == node_->asked.end()) {
    node_->asked.emplace_back(key);
  }
  const ConfigNode::Entry* entry = node_->Find(key);
  if (entry != nullptr) return entry->value.get();
  if (required) tree_->AddProblem(node_->place, absl::StrCat("missing key `", PathOf(key), "`"));
  return nullptr;
}

ConfigNode* ConfigSection::FindScalar(absl::string_view key, absl::string_view what,
                                      bool required) const {
  ConfigNode* node = Find(key, required);
  if (node == nullptr) return nullptr;
  if (node->kind == ConfigNode::Kind::kNull) {
    Problem(key, absl::StrCat("`", key, "` is empty; write ", what, " or leave the key out"));
    return nullptr;
  }
  if (node->kind != ConfigNode::Kind::kScalar) {
    Problem(key, absl::StrCat("`", key, "` is ", KindName(*node), "; write ", what));
    return nullptr;
  }
  return node;
}

void ConfigSection::ReadString(absl::string_view key, std::string* value, bool required) const {
  if (const ConfigNode* node = FindScalar(key, "a text", required)) {
    if (required && node->text.empty()) {
      Problem(key, absl::StrCat("`", key, "` must not be empty"));
    } else if (HasControlCharacter(node->text)) {
      Problem(key, absl::StrCat("`", key, "` contains a control character"));
    } else {
      *value = node->text;
    }
  }
  AddSetting(key, absl::StrCat("\"", *value, "\""));
}

void ConfigSection::ReadBool(absl::string_view key, bool* value, bool required) const {
  constexpr absl::string_view kWhat = "`true` or `false`";
  if (const ConfigNode* node = FindScalar(key, kWhat, required)) {
    if (!node->quoted && (node->text == "true" || node->text == "false")) {
      *value = node->text == "true";
    } else {
      Problem(key, absl::StrCat("`", key, "` is `", node->text, "`; write ", kWhat));
    }
  }
  AddSetting(key, *value ? "true" : "false");
}

void ConfigSection::ReadInt(absl::string_view key, int64_t* value, ConfigRange<int64_t> range,
                            bool required) const {
  if (const ConfigNode* node = FindScalar(key, "a whole number", required)) {
    int64_t number = 0;
    if (node->quoted || !ParseWhole(node->text, &number)) {
      Problem(key, absl::StrCat("`", key, "` is `", node->text, "`; write a whole number"));
    } else if (number < range.min || number > range.max) {
      Problem(key, absl::StrCat("`", key, "` is ", number, "; it must be from ", range.min, " to ",
                                range.max));
    } else {
      *value = number;
    }
  }
  AddSetting(key, absl::StrCat(*value));
}

void ConfigSection::ReadQuantity(absl::string_view key, absl::Duration* value,
                                 ConfigRange<absl::Duration> range, bool required) const {
  if (const ConfigNode* node = FindScalar(key, "a duration such as `500ms`", required)) {
    const absl::StatusOr<absl::Duration> duration = ParseConfigDuration(node->text);
    if (!duration.ok()) {
      Problem(key, absl::StrCat("`", key, "`: ", duration.status().message()));
    } else if (*duration < range.min || *duration > range.max) {
      Problem(key, absl::StrCat("`", key, "` is ", node->text, "; it must be from ",
                                FormatConfigDuration(range.min), " to ",
                                FormatConfigDuration(range.max)));
    } else {
      *value = *duration;
    }
  }
  AddSetting(key, FormatConfigDuration(*value));
}

void ConfigSection::ReadQuantity(absl::string_view key, ByteSize* value,
                                 ConfigRange<ByteSize> range, bool required) const {
  if (const ConfigNode* node = FindScalar(key, "a size such as `64KiB`", required)) {
    const absl::StatusOr<ByteSize> size = ParseByteSize(node->text);
    if (!size.ok()) {
      Problem(key, absl::StrCat("`", key, "`: ", size.status().message()));
    } else if (*size < range.min || *size > range.max) {
      Problem(key, absl::StrCat("`", key, "` is ", node->text, "; it must be from ",
                                FormatByteSize(range.min), " to ", FormatByteSize(range.max)));
    } else {
      *value = *size;
    }
  }
  AddSetting(key, FormatByteSize(*value));
}

void ConfigSection::ReadStrings(absl::string_view key, std::vector<std::string>* value,
                                bool required) const {
  if (const ConfigNode* node = Find(key, required)) {
    std::vector<std::string> texts;
    bool good = node->kind == ConfigNode::Kind::kList;
    if (!good) Problem(key, absl::StrCat("`", key, "` is ", KindName(*node), "; write a list"));
    for (const auto& item : node->items) {
      if (item->kind == ConfigNode::Kind::kScalar && !HasControlCharacter(item->text)) {
        texts.push_back(item->text);
      } else {
        good = false;
        tree_->AddProblem(item->place, absl::StrCat("`", key, "` must be a list of texts"));
      }
    }
    if (good && required && texts.empty()) {
      good = false;
      Problem(key, absl::StrCat("`", key, "` must not be empty"));
    }
    if (good) *value = std::move(texts);
  }
  AddSetting(key,
             value->empty() ? "[]" : absl::StrCat("[\"", absl::StrJoin(*value, "\", \""), "\"]"));
}

int ConfigSection::ReadName(absl::string_view key, const std::vector<std::string>& names,
                            absl::string_view now, bool required) const {
  int index = -1;
  const std::string what = absl::StrCat("`", absl::StrJoin(names, "` or `"), "`");
  if (const ConfigNode* node = FindScalar(key, what, required)) {
    const auto found = std::find(names.begin(), names.end(), node->text);
    if (found == names.end()) {
      Problem(key, absl::StrCat("`", key, "` is `", node->text, "`; write ", what));
    } else {
      index = static_cast<int>(found - names.begin());
    }
  }
  AddSetting(key, index < 0 ? now : absl::string_view(names[index]));
  return index;
}

ConfigSection ConfigSection::Section(absl::string_view key, bool required) const {
  ConfigNode* node = Find(key, required);
  if (node != nullptr && node->kind != ConfigNode::Kind::kMap) {
    if (required || node->kind != ConfigNode::Kind::kNull) {
      Problem(key, absl::StrCat("`", key, "` is ", KindName(*node), "; write a mapping"));
    }
    node = nullptr;
  }
  if (node != nullptr) node->visited = true;
  return ConfigSection(tree_, node, PathOf(key));
}

std::vector<ConfigSection> ConfigSection::Sections(absl::string_view key) const {
  std::vector<ConfigSection> sections;
  const ConfigNode* node = Find(key, false);
  if (node == nullptr) return sections;
  if (node->kind != ConfigNode::Kind::kList) {
    Problem(key, absl::StrCat("`", key, "` is ", KindName(*node), "; write a list of mappings"));
    return sections;
  }
  for (size_t i = 0; i < node->items.size(); ++i) {
    ConfigNode* item = node->items[i].get();
    if (item->kind != ConfigNode::Kind::kMap) {
      tree_->AddProblem(
          item->place,
          absl::StrCat("`", key, "` must be a list of mappings; this is ", KindName(*item)));
      continue;
    }
    item->visited = true;
    sections.push_back(ConfigSection(tree_, item, absl::StrCat(PathOf(key), "[", i, "]")));
  }
  return sections;
}

ConfigReader::ConfigReader(absl::string_view file, absl::string_view text,
                           std::vector<ConfigSetting> overrides)
    : tree_(std::make_unique<ConfigTree>(file, text, std::move(overrides))) {}

ConfigReader::~ConfigReader() = default;

ConfigSection ConfigReader::root() {
  if (tree_->root() != nullptr) tree_->root()->visited = true;
  return ConfigSection(tree_.get(), tree_->root(), "");
}

absl::Status ConfigReader::Finish() {
  tree_->ReportUnknownKeys();
  return tree_->Problems();
}

const std::vector<ConfigSetting>& ConfigReader::Settings() const { return tree_->settings(); }

std::string FormatSettings(const std::vector<ConfigSetting>& settings) {
  std::string text;
  for (const ConfigSetting& each : settings) {
    absl::StrAppend(&text, each.path, ": ", each.value, "  # ",
                    each.source.empty() ? "default" : each.source, "\n");
  }
  return text;
}

}  // namespace rips
