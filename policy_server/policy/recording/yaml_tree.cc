#include "policy_server/policy/recording/yaml_tree.h"

#include <algorithm>
#include <exception>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"
#include "yaml-cpp/eventhandler.h"
#include "yaml-cpp/exceptions.h"
#include "yaml-cpp/parser.h"

namespace rips::recording {
namespace {

// Builds the tree from below: a list or mapping joins its parent when it is complete. After the
// first error everything is dropped.
class TreeBuilder final : public YAML::EventHandler {
 public:
  explicit TreeBuilder(uint64_t first_line) : first_line_(first_line) {}

  absl::StatusOr<YamlNode> Take() {
    if (!status_.ok()) return status_;
    return std::move(root_);
  }
  uint64_t LineOf(const YAML::Mark& mark) const {
    return first_line_ + static_cast<uint64_t>(std::max(mark.line, 0));
  }

  void OnDocumentStart(const YAML::Mark&) override {}
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override {
    if (Begin(mark, anchor)) Add({.line = LineOf(mark)});
  }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override {
    Fail(absl::StatusCode::kInvalidArgument, LineOf(mark), "aliases are not supported");
  }
  void OnScalar(const YAML::Mark& mark, const std::string&, YAML::anchor_t anchor,
                const std::string& value) override {
    if (!Begin(mark, anchor)) return;
    Add({.kind = YamlNode::Kind::kScalar, .line = LineOf(mark), .text = value});
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value) override {
    Open(mark, anchor, YamlNode::Kind::kList);
  }
  void OnSequenceEnd() override { Close(); }
  void OnMapStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value) override {
    Open(mark, anchor, YamlNode::Kind::kMap);
  }
  void OnMapEnd() override { Close(); }

 private:
  struct Level {
    YamlNode node;
    // Of a mapping: the key whose value comes next.
    std::optional<std::string> key;
  };

  void Fail(absl::StatusCode code, uint64_t line, absl::string_view what) {
    if (status_.ok()) status_ = AtLine(code, line, what);
  }
  // Counts a node. False if it is to be dropped.
  bool Begin(const YAML::Mark& mark, YAML::anchor_t anchor) {
    if (anchor != 0) {
      Fail(absl::StatusCode::kInvalidArgument, LineOf(mark), "anchors are not supported");
    }
    if (++nodes_ > kYamlNodesMax) {
      Fail(absl::StatusCode::kResourceExhausted, LineOf(mark),
           absl::StrCat("more values in one document than the limit of ", kYamlNodesMax));
    }
    return status_.ok();
  }
  void Open(const YAML::Mark& mark, YAML::anchor_t anchor, YamlNode::Kind kind) {
    if (Begin(mark, anchor) && open_.size() >= kYamlDepthMax) {
      Fail(absl::StatusCode::kResourceExhausted, LineOf(mark),
           absl::StrCat("nesting exceeds the limit of ", kYamlDepthMax));
    }
    if (status_.ok()) open_.push_back({.node = {.kind = kind, .line = LineOf(mark)}});
  }
  void Close() {
    if (!status_.ok()) return;
    YamlNode node = std::move(open_.back().node);
    open_.pop_back();
    Add(std::move(node));
  }
  void Add(YamlNode node) {
    if (open_.empty()) {
      root_ = std::move(node);
      return;
    }
    Level& level = open_.back();
    if (level.node.kind == YamlNode::Kind::kList) {
      level.node.items.push_back(std::move(node));
    } else if (level.key) {
      node.key = *std::move(level.key);
      level.key.reset();
      level.node.items.push_back(std::move(node));
    } else {
      AddKey(level, std::move(node));
    }
  }
  void AddKey(Level& level, YamlNode node) {
    const std::vector<YamlNode>& values = level.node.items;
    const auto same = [&](const YamlNode& value) { return value.key == node.text; };
    if (node.kind != YamlNode::Kind::kScalar) {
      Fail(absl::StatusCode::kInvalidArgument, node.line, "a key must be a text");
    } else if (values.size() >= kYamlKeysMax) {
      Fail(absl::StatusCode::kResourceExhausted, node.line,
           absl::StrCat("more keys in one mapping than the limit of ", kYamlKeysMax));
    } else if (std::any_of(values.begin(), values.end(), same)) {
      Fail(absl::StatusCode::kInvalidArgument, node.line,
           absl::StrCat("key `", ros2::Printable(node.text), "` is there twice"));
    }
    level.key = std::move(node.text);
  }

  const uint64_t first_line_;
  absl::Status status_;
  size_t nodes_ = 0;
  YamlNode root_;
  std::vector<Level> open_;
};

}  // namespace

const YamlNode* YamlNode::Find(absl::string_view wanted) const {
  if (kind != Kind::kMap) return nullptr;
  for (const YamlNode& value : items) {
    if (value.key == wanted) return value.kind == Kind::kNull ? nullptr : &value;
  }
  return nullptr;
}

absl::Status AtLine(absl::StatusCode code, uint64_t line, absl::string_view what) {
  return absl::Status(code, absl::StrCat("line ", line, ": ", what));
}

absl::StatusOr<YamlNode> ParseYaml(const std::string& text, uint64_t first_line) {
  TreeBuilder builder(first_line);
  try {
    std::istringstream in(text);
    YAML::Parser parser(in);
    parser.HandleNextDocument(builder);
    TreeBuilder rest(first_line);
    if (parser.HandleNextDocument(rest)) {
      return AtLine(absl::StatusCode::kInvalidArgument, first_line,
                    "not YAML: something follows the document's content");
    }
  } catch (const YAML::Exception& error) {
    return AtLine(absl::StatusCode::kInvalidArgument, builder.LineOf(error.mark),
                  absl::StrCat("not YAML: ", error.msg));
  } catch (const std::exception& error) {
    return AtLine(absl::StatusCode::kInvalidArgument, first_line,
                  absl::StrCat("not YAML: ", error.what()));
  }
  return builder.Take();
}

}  // namespace rips::recording
