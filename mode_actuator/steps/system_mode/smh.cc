#include "mode_actuator/steps/system_mode/smh.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <set>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/text/quote.h"
#include "yaml-cpp/yaml.h"

namespace rips::actuator {
namespace {

constexpr size_t kPartsShown = 8;  // in one message
constexpr int kNestingMax = 16;    // namespaces, and dots of a parameter name

std::string Absolute(absl::string_view name) {
  return name.empty() || name.front() != '/' ? absl::StrCat("/", name) : std::string(name);
}

// What a mode of a system says of one part, before it is known what that part is.
struct RawTarget {
  PartTarget target;
  YAML::Mark at;
};

struct RawSystem {
  std::vector<std::pair<std::string, absl::btree_map<std::string, RawTarget>>> modes;
  std::vector<std::string> default_order;
  absl::btree_map<std::string, YAML::Mark> places;  // of modes
  YAML::Node parts;
  YAML::Node rules;
};

class SmhReader {
 public:
  explicit SmhReader(absl::string_view name) : name_(name) {}

  absl::StatusOr<Smh> Read(absl::string_view text) {
    if (text.size() > kSmhBytesMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat("`", name_, "` has ", text.size(), " bytes, limit ", kSmhBytesMax));
    }
    // yaml-cpp reports by exception; none leaves this function.
    try {
      const YAML::Node root = YAML::Load(std::string(text));
      if (!root.IsMap()) {
        Problem(root.Mark(), "expected a map of parts");
      } else {
        ReadBlocks(root, "", 0);
        LinkSystems();
        CheckRules();
        CheckCycles();
      }
    } catch (const YAML::Exception& e) {
      Problem(e.mark, absl::CHexEscape(e.msg));
    }
    if (!problems_.empty()) {
      problems_.insert(problems_.end(), smh_.warnings.begin(), smh_.warnings.end());
      return absl::InvalidArgumentError(absl::StrJoin(problems_, "\n"));
    }
    return std::move(smh_);
  }

 private:
  void Problem(const YAML::Mark& at, absl::string_view text) {
    if (problems_.size() > kSmhProblemsMax) return;
    if (problems_.size() == kSmhProblemsMax) {
      problems_.push_back("more problems not shown");
      return;
    }
    problems_.push_back(absl::StrCat(name_, ":", Position(at), ": ", text));
  }

  static std::string Position(const YAML::Mark& at) {
    return at.is_null() ? "1:1" : absl::StrCat(at.line + 1, ":", at.column + 1);
  }

  // Counts every visit, so that aliases cannot make a small file cost much.
  bool Charge(const YAML::Node& node) {
    if (++visited_ <= kSmhNodesMax) return true;
    if (visited_ == kSmhNodesMax + 1) {
      Problem(node.Mark(), absl::StrCat("more than ", kSmhNodesMax, " values"));
    }
    return false;
  }

  // Calls `visit(key, key node, value)` for each entry; a key that is not a scalar or is repeated
  // is a problem.
  template <typename Visit>
  void ForEach(const YAML::Node& map, Visit visit) {
    std::set<std::string> seen;
    for (const auto& entry : map) {
      if (!Charge(entry.second)) return;
      if (!entry.first.IsScalar() || entry.first.Scalar().empty()) {
        Problem(entry.first.Mark(), "a key must be a name");
        continue;
      }
      const std::string& key = entry.first.Scalar();
      if (!seen.insert(key).second) {
        Problem(entry.first.Mark(), absl::StrCat("duplicate key ", QuoteBytes(key)));
        continue;
      }
      visit(key, entry.first, entry.second);
    }
  }

  void ReadBlocks(const YAML::Node& map, const std::string& prefix, int depth) {
    if (depth > kNestingMax) {
      Problem(map.Mark(), absl::StrCat("namespaces nested deeper than ", kNestingMax));
      return;
    }
    ForEach(map, [&](const std::string& key, const YAML::Node& at, const YAML::Node& value) {
      const std::string part =
          absl::StrCat(prefix, "/", absl::StripPrefix(absl::StripSuffix(key, "/"), "/"));
      if (!value.IsMap()) {
        Problem(at.Mark(), absl::StrCat("block ", QuoteBytes(part), " is not a map"));
      } else if (value["ros__parameters"]) {
        ReadPart(part, at, value["ros__parameters"]);
      } else {
        ReadBlocks(value, part, depth + 1);
      }
    });
  }

  void ReadPart(const std::string& part, const YAML::Node& at, const YAML::Node& body) {
    if (raw_.contains(part) || smh_.nodes.contains(part)) {
      Problem(at.Mark(), absl::StrCat("part ", QuoteBytes(part), " has two blocks"));
      return;
    }
    const YAML::Node type = body.IsMap() ? body["type"] : YAML::Node();
    const bool is_node = type && type.IsScalar() && type.Scalar() == "node";
    const bool is_system = type && type.IsScalar() && type.Scalar() == "system";
    // An entry exists even for a faulty block, so that one mistake gives one message.
    if (is_node) {
      smh_.nodes[part];
    } else {
      raw_[part];
    }
    if (!is_node && !is_system) {
      faulty_.insert(part);
      Problem(type ? type.Mark() : at.Mark(),
              absl::StrCat("`type` of ", QuoteBytes(part), " must be `node` or `system`"));
      return;
    }
    const YAML::Node modes = body["modes"];
    if (!modes || !modes.IsMap() || modes.size() == 0) {
      faulty_.insert(part);
      Problem(at.Mark(), absl::StrCat(QuoteBytes(part),
                                      " has no modes; the mode manager crashes at the "
                                      "first order, give it `__DEFAULT__` with a parameter "
                                      "(`use_sim_time: false` if it has none of its own)"));
      return;
    }
    if (!modes.begin()->first.IsScalar() || modes.begin()->first.Scalar() != kDefaultMode) {
      faulty_.insert(part);
      Problem(modes.begin()->first.Mark(),
              absl::StrCat("the first mode of ", QuoteBytes(part), " must be `__DEFAULT__`"));
      return;
    }
    if (is_node) {
      ReadNodeModes(part, modes);
    } else {
      ReadSystemModes(part, modes);
      if (const YAML::Node parts = body["parts"]) raw_[part].parts.reset(parts);
      if (const YAML::Node rules = body["rules"]) raw_[part].rules.reset(rules);
    }
  }

  // --- nodes

  void ReadNodeModes(const std::string& part, const YAML::Node& modes) {
    SmhNode& node = smh_.nodes[part];
    ForEach(modes, [&](const std::string& mode, const YAML::Node& at, const YAML::Node& value) {
      ParameterMap parameters;
      const YAML::Node body = value.IsMap() ? value["ros__parameters"] : YAML::Node();
      if (body && body.IsMap()) ReadParameters(body, "", 0, parameters);
      if (parameters.empty()) {
        Problem(at.Mark(), absl::StrCat("mode ", QuoteBytes(mode), " of node ", QuoteBytes(part),
                                        " has no parameter; `ros__parameters` needs at least one"));
      }
      const ParameterMap& defaults = node.modes[std::string(kDefaultMode)];
      if (mode != kDefaultMode) {
        for (const auto& [key, unused] : parameters) {
          if (!defaults.contains(key) && !defaults.empty()) {
            Problem(at.Mark(),
                    absl::StrCat("parameter ", QuoteBytes(key), " of mode ", QuoteBytes(mode),
                                 " is not in `__DEFAULT__` of ", QuoteBytes(part)));
          }
        }
      }
      ParameterMap complete = mode == kDefaultMode ? ParameterMap() : defaults;
      for (auto& [key, parameter] : parameters) complete[key] = std::move(parameter);
      node.modes[mode] = std::move(complete);
    });
  }

  void ReadParameters(const YAML::Node& map, const std::string& prefix, int depth,
                      ParameterMap& out) {
    if (depth > kNestingMax) {
      Problem(map.Mark(), absl::StrCat("parameters nested deeper than ", kNestingMax));
      return;
    }
    ForEach(map, [&](const std::string& key, const YAML::Node& at, const YAML::Node& value) {
      const std::string full = prefix.empty() ? key : absl::StrCat(prefix, ".", key);
      if (value.IsMap()) {
        ReadParameters(value, full, depth + 1, out);
      } else if (value.IsScalar()) {
        out[full] = ReadValue(value);
      } else {
        Problem(at.Mark(), absl::StrCat("parameter ", QuoteBytes(full),
                                        " must be a string, integer, "
                                        "boolean or float"));
      }
    });
  }

  // As rcl_yaml_param_parser types an untagged scalar.
  static ros2::ParameterValue ReadValue(const YAML::Node& value) {
    const std::string& text = value.Scalar();
    if (value.Tag() == "!") return text;  // quoted
    static constexpr absl::string_view kTrue[] = {"Y",    "y",    "yes", "Yes", "YES", "true",
                                                  "True", "TRUE", "on",  "On",  "ON"};
    static constexpr absl::string_view kFalse[] = {"N",     "n",     "no",  "No",  "NO", "false",
                                                   "False", "FALSE", "off", "Off", "OFF"};
    for (absl::string_view word : kTrue) {
      if (text == word) return true;
    }
    for (absl::string_view word : kFalse) {
      if (text == word) return false;
    }
    if (int64_t integer = 0; absl::SimpleAtoi(text, &integer)) return integer;
    if (int64_t hex = 0; absl::StartsWith(text, "0x") && absl::SimpleHexAtoi(text, &hex)) {
      return hex;
    }
    if (double real = 0; absl::SimpleAtod(text, &real)) return real;
    return text;
  }

  // --- systems

  void ReadSystemModes(const std::string& part, const YAML::Node& modes) {
    RawSystem& system = raw_[part];
    ForEach(modes, [&](const std::string& mode, const YAML::Node& at, const YAML::Node& value) {
      if (!value.IsMap() || value.size() == 0) {
        Problem(at.Mark(), absl::StrCat("mode ", QuoteBytes(mode), " of system ", QuoteBytes(part),
                                        " names no part"));
        return;
      }
      system.places[mode] = at.Mark();
      absl::btree_map<std::string, RawTarget> targets;
      ForEach(value,
              [&](const std::string& key, const YAML::Node& key_at, const YAML::Node& state) {
                const std::string target_part = Absolute(key);
                if (const std::optional<PartTarget> target = ReadTarget(state)) {
                  targets[target_part] = {*target, state.Mark()};
                } else {
                  Problem(state.Mark(), absl::StrCat("state of ", QuoteBytes(key),
                                                     " must be `inactive`, "
                                                     "`active` or `active.MODE`, in lower case"));
                  targets[target_part] = {{PartState::kInactive, ""}, key_at.Mark()};
                }
                if (mode == kDefaultMode) system.default_order.push_back(target_part);
              });
      system.modes.emplace_back(mode, std::move(targets));
    });
  }

  static std::optional<PartTarget> ReadTarget(const YAML::Node& state) {
    if (!state.IsScalar()) return std::nullopt;
    const std::vector<std::string> words = absl::StrSplit(state.Scalar(), absl::MaxSplits('.', 1));
    if (words.size() == 2 && words[1].empty()) return std::nullopt;
    // A mode after `inactive` is accepted and has no effect upstream.
    if (words[0] == "inactive") return PartTarget{PartState::kInactive, ""};
    if (words[0] != "active") return std::nullopt;
    return PartTarget{PartState::kActive, words.size() == 2 ? words[1] : std::string(kDefaultMode)};
  }

  bool HasMode(const std::string& part, const std::string& mode) const {
    if (const auto node = smh_.nodes.find(part); node != smh_.nodes.end()) {
      return node->second.modes.contains(mode);
    }
    const auto system = raw_.find(part);
    if (system == raw_.end()) return false;
    for (const auto& [name, unused] : system->second.modes) {
      if (name == mode) return true;
    }
    return false;
  }

  void CheckTarget(const std::string& part, const RawTarget& raw, absl::string_view where) {
    if (!raw_.contains(part) && !smh_.nodes.contains(part)) {
      if (missing_.insert(part).second) {
        Problem(raw.at, absl::StrCat("part ", QuoteBytes(part), " (", where,
                                     ") has no block; the mode "
                                     "manager crashes at the first order, add one"));
      }
      return;
    }
    if (faulty_.contains(part)) return;
    if (raw.target.state == PartState::kActive && !HasMode(part, raw.target.mode)) {
      Problem(raw.at, absl::StrCat("part ", QuoteBytes(part), " has no mode ",
                                   QuoteBytes(raw.target.mode)));
    }
  }

  void LinkSystems() {
    for (const auto& [name, raw] : raw_) {
      SmhSystem& system = smh_.systems[name];
      system.parts = raw.default_order;
      const absl::btree_map<std::string, RawTarget>* defaults = nullptr;
      for (const auto& [mode, targets] : raw.modes) {
        const std::string where = absl::StrCat("mode ", QuoteBytes(mode), " of ", QuoteBytes(name));
        for (const auto& [part, target] : targets) {
          CheckTarget(part, target, where);
          if (defaults != nullptr && !defaults->contains(part)) {
            Problem(target.at, absl::StrCat("part ", QuoteBytes(part), " of ", where,
                                            " is not in `__DEFAULT__`"));
          }
        }
        if (defaults == nullptr) defaults = &targets;
        auto& complete = system.modes[mode];
        for (const auto& [part, target] : *defaults) complete[part] = target.target;
        for (const auto& [part, target] : targets) complete[part] = target.target;
        system.places[mode] = absl::StrCat(name_, ":", Position(raw.places.at(mode)));
      }
      CompareParts(name, raw);
    }
  }

  // The list that upstream ignores, against what counts.
  void CompareParts(const std::string& name, const RawSystem& raw) {
    if (!raw.parts.IsDefined() || raw.parts.IsNull() || raw.default_order.empty()) return;
    std::set<std::string> listed;
    if (raw.parts.IsScalar()) {
      for (absl::string_view part :
           absl::StrSplit(raw.parts.Scalar(), absl::ByAnyChar(" \t\n"), absl::SkipEmpty())) {
        listed.insert(Absolute(part));
      }
    } else if (raw.parts.IsSequence()) {
      for (const YAML::Node& part : raw.parts) {
        if (Charge(part) && part.IsScalar()) listed.insert(Absolute(part.Scalar()));
      }
    }
    const std::set<std::string> used(raw.default_order.begin(), raw.default_order.end());
    if (listed == used) return;
    std::vector<std::string> differing;
    std::set_symmetric_difference(listed.begin(), listed.end(), used.begin(), used.end(),
                                  std::back_inserter(differing));
    const size_t shown = std::min(differing.size(), kPartsShown);
    smh_.warnings.push_back(
        absl::StrCat(name_, ":", Position(raw.parts.Mark()), ": `parts` of ", QuoteBytes(name),
                     " names ", listed.size(), ", its `__DEFAULT__` ", used.size(),
                     ", which is what counts; in one of them only: ",
                     absl::StrJoin(differing.begin(), differing.begin() + shown, ", ",
                                   [](std::string* out, const std::string& part) {
                                     absl::StrAppend(out, QuoteBytes(part));
                                   }),
                     shown < differing.size() ? ", ..." : ""));
  }

  // --- rules

  void CheckRules() {
    for (const auto& [name, raw] : raw_) {
      if (raw.rules.IsNull()) continue;
      if (!raw.rules.IsMap()) {
        Problem(raw.rules.Mark(), absl::StrCat("`rules` of ", QuoteBytes(name), " is not a map"));
        continue;
      }
      const std::string system = name;
      ForEach(raw.rules, [&](const std::string& rule, const YAML::Node& at,
                             const YAML::Node& body) { CheckRule(system, rule, at, body); });
    }
  }

  void CheckRule(const std::string& system, const std::string& rule, const YAML::Node& at,
                 const YAML::Node& body) {
    const YAML::Node if_target = body.IsMap() ? body["if_target"] : YAML::Node();
    const YAML::Node if_part = body.IsMap() ? body["if_part"] : YAML::Node();
    const YAML::Node new_target = body.IsMap() ? body["new_target"] : YAML::Node();
    if (!if_target || !if_part || !new_target || body.size() != 3) {
      Problem(at.Mark(), absl::StrCat("rule ", QuoteBytes(rule),
                                      " needs exactly `if_target`, `if_part` "
                                      "and `new_target`"));
      return;
    }
    for (const YAML::Node& target : {if_target, new_target}) {
      CheckRuleTarget(system, target);
    }
    if (!if_part.IsSequence() || if_part.size() != 2 || !if_part[0].IsScalar()) {
      Problem(if_part.Mark(), "`if_part` must be a list of a part and its state");
      return;
    }
    const std::string part = Absolute(if_part[0].Scalar());
    const auto& parts = smh_.systems[system].parts;
    if (std::find(parts.begin(), parts.end(), part) == parts.end()) {
      Problem(if_part[0].Mark(),
              absl::StrCat(QuoteBytes(part), " is not a part of ", QuoteBytes(system)));
    } else {
      CheckRuleTarget(part, if_part[1]);
    }
    smh_.warnings.push_back(absl::StrCat(name_, ":", Position(at.Mark()), ": rule ",
                                         QuoteBytes(rule), " of ", QuoteBytes(system),
                                         " lets the mode manager leave a mode that was ordered"));
  }

  void CheckRuleTarget(const std::string& part, const YAML::Node& text) {
    const std::optional<PartTarget> target = ReadTarget(text);
    if (!target.has_value()) {
      Problem(text.Mark(), "expected `inactive`, `active` or `active.MODE`, in lower case");
    } else if (target->state == PartState::kActive && !faulty_.contains(part) &&
               (raw_.contains(part) || smh_.nodes.contains(part)) && !HasMode(part, target->mode)) {
      Problem(text.Mark(),
              absl::StrCat("part ", QuoteBytes(part), " has no mode ", QuoteBytes(target->mode)));
    }
  }

  // --- a system must not contain itself

  void CheckCycles() {
    std::set<std::string> done;
    for (const auto& [name, unused] : smh_.systems) {
      std::vector<std::string> path;
      Visit(name, path, done);
    }
  }

  void Visit(const std::string& part, std::vector<std::string>& path, std::set<std::string>& done) {
    const auto system = smh_.systems.find(part);
    if (system == smh_.systems.end() || done.contains(part)) return;
    if (std::find(path.begin(), path.end(), part) != path.end()) {
      Problem(YAML::Mark::null_mark(),
              absl::StrCat("system ", QuoteBytes(part),
                           " contains itself: ", absl::StrJoin(path, " > ")));
      return;
    }
    if (path.size() >= static_cast<size_t>(kNestingMax)) {
      Problem(YAML::Mark::null_mark(),
              absl::StrCat("systems nested deeper than ", kNestingMax, " at ", QuoteBytes(part)));
      return;
    }
    path.push_back(part);
    for (const std::string& child : system->second.parts) Visit(child, path, done);
    path.pop_back();
    done.insert(part);
  }

  const std::string name_;
  Smh smh_;
  absl::btree_map<std::string, RawSystem> raw_;
  std::set<std::string> faulty_;
  std::set<std::string> missing_;
  std::vector<std::string> problems_;
  size_t visited_ = 0;
};

}  // namespace

absl::StatusOr<Smh> ParseSmh(absl::string_view text, absl::string_view name) {
  return SmhReader(name).Read(text);
}

}  // namespace rips::actuator
