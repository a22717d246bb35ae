// The alert levels of a policy, least restrictive first (RIPS paper, "Alert levels").
#ifndef RIPS_POLICY_SERVER_POLICY_LEVELS_LEVEL_TABLE_H_
#define RIPS_POLICY_SERVER_POLICY_LEVELS_LEVEL_TABLE_H_

#include <optional>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace rips::levels {

// Position in the table, from 0. A higher one is more restrictive.
using LevelIndex = int;

struct Level {
  std::string name;
  // Rules may leave it downwards, by one.
  bool soft = false;

  friend bool operator==(const Level&, const Level&) = default;
};

// Immutable. Names are distinct; at most 64 levels (the checker sees to both).
class LevelTable {
 public:
  LevelTable() = default;
  explicit LevelTable(std::vector<Level> levels) : levels_(std::move(levels)) {}

  int size() const { return static_cast<int>(levels_.size()); }
  bool contains(LevelIndex index) const { return index >= 0 && index < size(); }
  // `index` must be in the table.
  const Level& at(LevelIndex index) const { return levels_.at(static_cast<size_t>(index)); }
  // Empty for an index out of range.
  std::string name(LevelIndex index) const { return contains(index) ? at(index).name : ""; }
  std::optional<LevelIndex> Find(absl::string_view name) const {
    for (int i = 0; i < size(); ++i) {
      if (at(i).name == name) return i;
    }
    return std::nullopt;
  }
  std::vector<std::string> names() const {
    std::vector<std::string> out;
    for (const Level& level : levels_) out.push_back(level.name);
    return out;
  }

  friend bool operator==(const LevelTable&, const LevelTable&) = default;

 private:
  std::vector<Level> levels_;
};

}  // namespace rips::levels

#endif  // RIPS_POLICY_SERVER_POLICY_LEVELS_LEVEL_TABLE_H_
