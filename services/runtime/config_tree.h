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

// 0-based; the column in bytes.
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
  ConfigTree(absl::string_view file, absl::string_view text);

  // Always a mapping; nullptr if the text could not be parsed.
  ConfigNode* root() { return root_.get(); }

  void AddProblem(ConfigPlace place, absl::string_view message);
  // Reports every key below the root that was not read.
  void ReportUnknownKeys() {
    if (root_ != nullptr) ReportUnknownKeys(*root_);
  }
  absl::Status Problems();

  // `line` from 1; 0: the text does not say it.
  void AddSetting(absl::string_view path, absl::string_view value, int line);
  const std::vector<ConfigSetting>& settings() const { return settings_; }

 private:
  struct Problem {
    ConfigPlace place;
    std::string message;
  };

  void Parse();
  void ReportUnknownKeys(const ConfigNode& node);
  std::string Format(const Problem& problem) const;

  const std::string file_;
  const std::string text_;
  std::unique_ptr<ConfigNode> root_;
  std::vector<Problem> problems_;
  std::vector<ConfigSetting> settings_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_CONFIG_TREE_H_
