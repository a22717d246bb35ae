// A parsed configuration text with the place of everything in it. Inside config_*.cc only.
#ifndef RIPS_SERVICES_RUNTIME_CONFIG_TREE_H_
#define RIPS_SERVICES_RUNTIME_CONFIG_TREE_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "services/base/config_setting.h"

namespace rips {

// 0-based; the column in bytes. A line below 0 is of an override (ConfigTree::OverrideLine).
struct ConfigPlace {
  int line = 0;
  int column = 0;
};

struct ConfigNode {
  enum class Kind { kNull, kScalar, kList, kMap };
  struct Entry {
    std::string key;
    ConfigPlace place;
    std::unique_ptr<ConfigNode> value;
  };

  const Entry* Find(absl::string_view key) const {
    for (const Entry& entry : entries) {
      if (entry.key == key) return &entry;
    }
    return nullptr;
  }
  Entry* Find(absl::string_view key) {
    return const_cast<Entry*>(static_cast<const ConfigNode*>(this)->Find(key));
  }

  Kind kind = Kind::kNull;
  ConfigPlace place;
  std::string text;                                // kScalar
  bool quoted = false;                             // kScalar
  std::vector<std::unique_ptr<ConfigNode>> items;  // kList
  std::vector<Entry> entries;                      // kMap, in order of the text, keys unique
  std::vector<std::string> asked;                  // kMap: the known keys
  bool visited = false;                            // kMap: someone asks for its keys
};

class ConfigTree {
 public:
  // Parses; see ConfigReader for what is a problem.
  ConfigTree(absl::string_view file, absl::string_view text, std::vector<ConfigSetting> overrides);

  // Always a mapping; nullptr if the text could not be parsed.
  ConfigNode* root() { return root_.get(); }

  void AddProblem(ConfigPlace place, absl::string_view message);
  // Reports every key below the root that was not read.
  void ReportUnknownKeys() {
    if (root_ != nullptr) ReportUnknownKeys(*root_);
  }
  absl::Status Problems();

  // `line` from 1; 0: nothing says it; below 0: of an override, its place's line plus 1.
  void AddSetting(absl::string_view path, absl::string_view value, int line);
  const std::vector<ConfigSetting>& settings() const { return settings_; }

 private:
  struct Problem {
    ConfigPlace place;
    std::string message;
  };

  // Of what `overrides_[index]` puts into the tree.
  static int OverrideLine(size_t index) { return -2 - static_cast<int>(index); }
  const ConfigSetting* OverrideAt(int line) const {
    return line > -2 ? nullptr : &overrides_[static_cast<size_t>(-2 - line)];
  }

  void Parse();
  void Override(size_t index);
  void ReportUnknownKeys(const ConfigNode& node);
  std::string Format(const Problem& problem) const;

  const std::string file_;
  const std::string text_;
  const std::vector<ConfigSetting> overrides_;
  std::unique_ptr<ConfigNode> root_;
  std::vector<Problem> problems_;
  std::vector<ConfigSetting> settings_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_CONFIG_TREE_H_
