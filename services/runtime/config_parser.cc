#include <algorithm>
#include <exception>
#include <sstream>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_tree.h"
#include "services/text/nearest.h"
#include "services/text/utf8.h"
#include "yaml-cpp/eventhandler.h"
#include "yaml-cpp/exceptions.h"
#include "yaml-cpp/parser.h"

namespace rips {
namespace {

ConfigPlace PlaceOf(const YAML::Mark& mark) {
  return {.line = std::max(mark.line, 0), .column = std::max(mark.column, 0)};
}

// Builds nodes from the events of one document. Below kConfigDepthMax events are dropped, so the
// tree is never deeper; yaml-cpp bounds its own recursion.
class TreeBuilder final : public YAML::EventHandler {
 public:
  explicit TreeBuilder(ConfigTree* tree) : tree_(tree) {}

  std::unique_ptr<ConfigNode> PopRoot() { return std::move(root_); }
  bool too_deep() const { return too_deep_; }

  void OnDocumentStart(const YAML::Mark&) override {}
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override {
    CheckPlain(mark, "", anchor);
    Add(mark, ConfigNode::Kind::kNull);
  }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override {
    tree_->AddProblem(PlaceOf(mark), "aliases are not supported; write the value out");
    Add(mark, ConfigNode::Kind::kNull);
  }
  void OnScalar(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                const std::string& value) override {
    CheckPlain(mark, tag, anchor);
    ConfigNode* node = Add(mark, ConfigNode::Kind::kScalar);
    if (node == nullptr) return;
    node->text = value;
    node->quoted = tag == "!";
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value) override {
    Open(mark, tag, anchor, ConfigNode::Kind::kList);
  }
  void OnSequenceEnd() override { Close(); }
  void OnMapStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value) override {
    Open(mark, tag, anchor, ConfigNode::Kind::kMap);
  }
  void OnMapEnd() override { Close(); }

 private:
  struct Level {
    ConfigNode* node;  // a list or mapping; nullptr if it is itself dropped
    bool expects_value = false;
    bool key_usable = false;
    std::string key;
    ConfigPlace key_place;
  };

  void CheckPlain(const YAML::Mark& mark, absl::string_view tag, YAML::anchor_t anchor) {
    if (anchor != 0) tree_->AddProblem(PlaceOf(mark), "anchors are not supported");
    if (!tag.empty() && tag != "?" && tag != "!") {
      tree_->AddProblem(PlaceOf(mark), absl::StrCat("tag `", tag, "` is not supported"));
    }
  }

  void Open(const YAML::Mark& mark, absl::string_view tag, YAML::anchor_t anchor,
            ConfigNode::Kind kind) {
    CheckPlain(mark, tag, anchor);
    ConfigNode* node = nullptr;
    if (stack_.size() < static_cast<size_t>(kConfigDepthMax)) {
      node = Add(mark, kind);
    } else if (!too_deep_) {
      too_deep_ = true;
      tree_->AddProblem(PlaceOf(mark),
                        absl::StrCat("nesting exceeds the limit of ", kConfigDepthMax));
    }
    stack_.push_back({.node = node});
  }
  void Close() { stack_.pop_back(); }

  // Puts a new node where the text has it. nullptr for a mapping's key and for what is dropped.
  ConfigNode* Add(const YAML::Mark& mark, ConfigNode::Kind kind) {
    auto node = std::make_unique<ConfigNode>();
    node->kind = kind;
    node->place = PlaceOf(mark);
    ConfigNode* added = node.get();
    if (stack_.empty()) {
      root_ = std::move(node);
      return added;
    }
    Level& level = stack_.back();
    if (level.node == nullptr) return nullptr;
    if (level.node->kind == ConfigNode::Kind::kList) {
      level.node->items.push_back(std::move(node));
      return added;
    }
    return AddToMap(level, std::move(node));
  }

  ConfigNode* AddToMap(Level& level, std::unique_ptr<ConfigNode> node) {
    if (!level.expects_value) {
      level.expects_value = true;
      level.key_place = node->place;
      level.key_usable = node->kind == ConfigNode::Kind::kScalar;
      if (!level.key_usable) {
        tree_->AddProblem(node->place, "a key must be a text");
        return nullptr;
      }
      // Its text follows in OnScalar; the node lives until the value comes.
      pending_key_ = std::move(node);
      return pending_key_.get();
    }
    level.expects_value = false;
    if (!level.key_usable) return nullptr;
    level.key = pending_key_->text;
    if (const ConfigNode::Entry* first = level.node->Find(level.key)) {
      tree_->AddProblem(level.key_place,
                        absl::StrCat("duplicate key `", level.key, "`; it is also on line ",
                                     first->place.line + 1));
      return nullptr;
    }
    ConfigNode* added = node.get();
    level.node->entries.push_back({level.key, level.key_place, std::move(node)});
    return added;
  }

  ConfigTree* tree_;
  std::unique_ptr<ConfigNode> root_;
  std::unique_ptr<ConfigNode> pending_key_;
  std::vector<Level> stack_;
  bool too_deep_ = false;
};

void SetPlace(ConfigNode& node, ConfigPlace place) {
  node.place = place;
  for (const auto& item : node.items) SetPlace(*item, place);
  for (ConfigNode::Entry& entry : node.entries) {
    entry.place = place;
    SetPlace(*entry.value, place);
  }
}

std::string Remedy(absl::string_view key, const std::vector<std::string>& known) {
  constexpr int kLimit = 2;
  int best_distance = kLimit + 1;
  absl::string_view best;
  for (const std::string& candidate : known) {
    const int distance = EditDistance(key, candidate, kLimit);
    if (distance < best_distance && 2 * static_cast<size_t>(distance) <= candidate.size()) {
      best_distance = distance;
      best = candidate;
    }
  }
  if (!best.empty()) return absl::StrCat("did you mean `", best, "`");
  if (known.empty()) return "no key is known here";
  return absl::StrCat("known keys are `", absl::StrJoin(known, "`, `"), "`");
}

// A secret where the file of one belongs, or the password of a URL: the line is not quoted.
bool MayHoldSecret(absl::string_view line) {
  const size_t scheme = line.find("://");
  return absl::StrContains(line, "secret") || absl::StrContains(line, "password") ||
         (scheme != absl::string_view::npos && absl::StrContains(line.substr(scheme), "@"));
}

}  // namespace

ConfigTree::ConfigTree(absl::string_view file, absl::string_view text,
                       std::vector<ConfigSetting> overrides)
    : file_(file), text_(text), overrides_(std::move(overrides)) {
  if (text.size() > kConfigBytesMax) {
    AddProblem({},
               absl::StrCat("the text is longer than the limit of ", kConfigBytesMax, " bytes"));
    return;
  }
  Parse();
  for (size_t i = 0; root_ != nullptr && i < overrides_.size(); ++i) Override(i);
}

void ConfigTree::Parse() {
  TreeBuilder builder(this);
  try {
    // yaml-cpp takes a quoted text without its end for good if a line break follows it.
    std::istringstream stream(std::string(absl::StripTrailingAsciiWhitespace(text_)));
    YAML::Parser parser(stream);
    parser.HandleNextDocument(builder);
    TreeBuilder rest(this);
    if (parser.HandleNextDocument(rest)) {
      AddProblem({}, "there are several documents (`---`); keep one");
    }
  } catch (const YAML::Exception& error) {
    AddProblem(PlaceOf(error.mark), absl::StrCat("not valid YAML: ", error.msg));
    return;
  } catch (const std::exception& error) {
    AddProblem({}, absl::StrCat("not valid YAML: ", error.what()));
    return;
  }
  if (builder.too_deep()) return;
  root_ = builder.PopRoot();
  if (root_ == nullptr) root_ = std::make_unique<ConfigNode>();
  if (root_->kind == ConfigNode::Kind::kNull) root_->kind = ConfigNode::Kind::kMap;
  if (root_->kind != ConfigNode::Kind::kMap) {
    AddProblem(root_->place, "the text is not a mapping; write `key: value` lines");
    root_ = nullptr;
  }
}

void ConfigTree::Override(size_t index) {
  const ConfigSetting& override = overrides_[index];
  const ConfigPlace place = {.line = OverrideLine(index)};
  // Its own problems have lines of its own; any of them spoils it.
  ConfigTree value("", absl::StrCat("value: ", override.value), {});
  const ConfigNode::Entry* parsed = value.root_ == nullptr ? nullptr : value.root_->Find("value");
  if (parsed == nullptr || value.root_->entries.size() != 1 || !value.problems_.empty()) {
    return AddProblem(place, absl::StrCat("`", override.path, "` is not a value in YAML"));
  }
  ConfigNode* map = root_.get();
  const std::vector<std::string> keys = absl::StrSplit(override.path, '.');
  for (size_t i = 0; i + 1 < keys.size(); ++i) {
    ConfigNode::Entry* entry = map->Find(keys[i]);
    if (entry == nullptr) {
      map->entries.push_back({keys[i], place, std::make_unique<ConfigNode>()});
      entry = &map->entries.back();
    }
    map = entry->value.get();
    if (map->kind == ConfigNode::Kind::kNull) map->kind = ConfigNode::Kind::kMap;
    if (map->kind != ConfigNode::Kind::kMap) {
      return AddProblem(place, absl::StrCat("`", keys[i], "` of the file is not a mapping"));
    }
  }
  ConfigNode::Entry* entry = map->Find(keys.back());
  if (entry == nullptr) {
    map->entries.push_back({keys.back(), place, nullptr});
    entry = &map->entries.back();
  }
  entry->place = place;
  entry->value = std::move(value.root_->entries[0].value);
  SetPlace(*entry->value, place);
}

void ConfigTree::AddProblem(ConfigPlace place, absl::string_view message) {
  problems_.push_back({place, std::string(message)});
}

void ConfigTree::ReportUnknownKeys(const ConfigNode& node) {
  if (node.kind == ConfigNode::Kind::kList) {
    for (const auto& item : node.items) ReportUnknownKeys(*item);
  }
  if (node.kind != ConfigNode::Kind::kMap || !node.visited) return;
  for (const ConfigNode::Entry& entry : node.entries) {
    if (std::find(node.asked.begin(), node.asked.end(), entry.key) != node.asked.end()) {
      ReportUnknownKeys(*entry.value);
    } else {
      AddProblem(entry.place,
                 absl::StrCat("unknown key `", entry.key, "`; ", Remedy(entry.key, node.asked)));
    }
  }
}

absl::Status ConfigTree::Problems() {
  if (problems_.empty()) return absl::OkStatus();
  std::stable_sort(problems_.begin(), problems_.end(), [](const Problem& a, const Problem& b) {
    return std::pair(a.place.line, a.place.column) < std::pair(b.place.line, b.place.column);
  });
  const size_t shown = std::min<size_t>(problems_.size(), kConfigProblemsMax);
  std::vector<std::string> lines;
  for (size_t i = 0; i < shown; ++i) lines.push_back(Format(problems_[i]));
  if (shown < problems_.size()) {
    lines.push_back(absl::StrCat("and ", problems_.size() - shown, " more problems"));
  }
  return absl::InvalidArgumentError(absl::StrJoin(lines, "\n"));
}

std::string ConfigTree::Format(const Problem& problem) const {
  constexpr size_t kShownBytesMax = 200;
  // Errors end up in logs. The message may quote the text, too.
  if (absl::StrContains(text_, "PRIVATE KEY-----")) {
    return absl::StrCat(file_, ":", problem.place.line + 1,
                        ": wrong, and not shown: the text holds a private key. Configuration names "
                        "the file that a key stands in");
  }
  if (const ConfigSetting* override = OverrideAt(problem.place.line)) {
    return absl::StrCat(override->source, ": ", problem.message);
  }
  const std::vector<absl::string_view> lines = absl::StrSplit(text_, '\n');
  const size_t index = static_cast<size_t>(problem.place.line);
  const absl::string_view line = index < lines.size() ? lines[index] : "";
  const absl::string_view before = line.substr(0, problem.place.column);
  std::string out = absl::StrCat(file_, ":", problem.place.line + 1, ":",
                                 CountCodePoints(before) + 1, ": ", problem.message);
  if (line.empty() || line.size() > kShownBytesMax || MayHoldSecret(line)) return out;
  std::string shown(line);
  for (char& c : shown) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = ' ';
  }
  absl::StrAppend(&out, "\n  ", shown, "\n  ", std::string(CountCodePoints(before), ' '), "^");
  return out;
}

void ConfigTree::AddSetting(absl::string_view path, absl::string_view value, int line) {
  std::string source;
  if (line > 0) source = absl::StrCat(file_, ":", line);
  if (line < 0) source = OverrideAt(line - 1)->source;
  settings_.push_back(
      {.path = std::string(path), .value = std::string(value), .source = std::move(source)});
}

}  // namespace rips
