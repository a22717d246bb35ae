#include "policy_server/policy/engine/state/robot_state.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/state/compiled.h"
#include "policy_server/policy/engine/state/internal.h"
#include "services/base/check.h"
#include "services/text/utf8.h"

namespace rips::engine {
namespace {

// A level that no table has.
constexpr levels::LevelIndex kNoLevel = std::numeric_limits<levels::LevelIndex>::max();

levels::LevelIndex Rename(levels::LevelIndex level, const levels::LevelTable& from,
                          const levels::LevelTable& to) {
  return to.Find(from.name(level)).value_or(kNoLevel);
}

std::vector<lang::Value> InitialValues(const CompiledPolicy& program) {
  std::vector<lang::Value> values;
  for (const lang::Variable& variable : program.rules().variables) {
    values.push_back(variable.initial);
  }
  return values;
}

// The value of a variable of `to` whose namesake in `from` has `value`; nullopt if it cannot be
// taken over. A position in the level table follows the level's name.
std::optional<lang::Value> Carry(const lang::Value& value, uint32_t old_index, uint32_t index,
                                 const CompiledPolicy& from, const CompiledPolicy& to) {
  if (from.rules().variables[old_index].type != to.rules().variables[index].type) {
    return std::nullopt;
  }
  if (!to.compiled().holds_level[index]) return value;
  const auto* level = std::get_if<int64_t>(&value);
  const levels::LevelTable& old_table = from.rules().levels;
  if (!from.compiled().holds_level[old_index] || level == nullptr || *level < 0 ||
      *level >= old_table.size()) {
    return std::nullopt;
  }
  const levels::LevelIndex renamed =
      Rename(static_cast<levels::LevelIndex>(*level), old_table, to.rules().levels);
  if (renamed == kNoLevel) return std::nullopt;
  return int64_t{renamed};
}

}  // namespace

RobotState::RobotState(std::shared_ptr<const CompiledPolicy> program,
                       levels::LevelMachine level_machine, Instant started, StateLimits limits)
    : level(std::move(level_machine)),
      program_(std::move(program)),
      internal_(std::make_unique<Internal>()) {
  RIPS_CHECK(level.table() == program_->rules().levels, "one table for rules and levels");
  internal_->limits = limits;
  internal_->started = started;
  internal_->values = InitialValues(*program_);
}

RobotState::~RobotState() = default;
RobotState::RobotState(RobotState&&) noexcept = default;
RobotState& RobotState::operator=(RobotState&&) noexcept = default;

absl::btree_map<std::string, lang::Value> RobotState::Variables() const {
  absl::btree_map<std::string, lang::Value> out;
  const std::vector<lang::Variable>& variables = program_->rules().variables;
  for (size_t i = 0; i < variables.size(); ++i) out[variables[i].name] = internal_->values[i];
  return out;
}

void RobotState::RestoreVariables(const absl::btree_map<std::string, lang::Value>& values) {
  for (const auto& [name, value] : values) {
    const auto index = program_->compiled().variable_of.find(name);
    if (index == program_->compiled().variable_of.end()) continue;
    lang::Value& slot = internal_->values[index->second];
    if (slot.index() != value.index()) continue;
    if (program_->compiled().holds_level[index->second]) {
      const auto* position = std::get_if<int64_t>(&value);
      if (position == nullptr || *position < 0 || *position >= program_->rules().levels.size()) {
        continue;
      }
    }
    slot = value;
    if (auto* text = std::get_if<std::string>(&slot)) {
      text->resize(CutCodePoints(*text, internal_->limits.string_max).size());
    }
  }
}

const Instant& RobotState::started() const { return internal_->started; }

const absl::btree_map<levels::LevelIndex, LevelRequests>& RobotState::level_requests() const {
  return internal_->level_requests;
}

absl::Status RobotState::SwapProgram(std::shared_ptr<const CompiledPolicy> program) {
  const levels::LevelTable old_table = level.table();
  if (!level.SwapTable(program->rules().levels)) {
    return absl::FailedPreconditionError(
        absl::StrCat("the policy has no level `", old_table.name(level.level()),
                     "`, at which the robot is; declare it or change the level first"));
  }

  Internal& in = *internal_;
  std::vector<lang::Value> values = InitialValues(*program);
  const std::vector<lang::Variable>& variables = program->rules().variables;
  for (uint32_t i = 0; i < values.size(); ++i) {
    const auto old_index = program_->compiled().variable_of.find(variables[i].name);
    if (old_index == program_->compiled().variable_of.end()) continue;
    std::optional<lang::Value> carried =
        Carry(in.values[old_index->second], old_index->second, i, *program_, *program);
    if (carried.has_value()) values[i] = *std::move(carried);
  }
  const auto left_behind = std::make_shared<const std::vector<lang::Value>>(std::move(in.values));
  for (const std::unique_ptr<ParkedChain>& parked : in.parked) {
    if (parked->program == program_) parked->left_behind = left_behind;
    parked->wants = Rename(parked->wants, old_table, program->rules().levels);
  }
  in.values = std::move(values);
  in.topics.Clear();
  in.fault_alerted_ns.clear();
  in.cut_rules.clear();
  in.refusals.clear();
  in.level_requests.clear();
  program_ = std::move(program);
  return absl::OkStatus();
}

}  // namespace rips::engine
