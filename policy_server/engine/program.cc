#include "policy_server/engine/program.h"

#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "policy_server/engine/compiled.h"
#include "policy_server/engine/topic_verdicts.h"

namespace rips::engine {
namespace {

using lang::Builtin;
using lang::EventClass;
using lang::TypedExpr;

// Memory that one expression and its automaton may take.
constexpr int64_t kRegexBytesMax = 1 << 20;

bool AllConstant(const std::vector<TypedExpr>& args) {
  for (const TypedExpr& arg : args) {
    if (arg.kind != TypedExpr::Kind::kConstant) return false;
  }
  return true;
}

bool IsTopicPredicate(const TypedExpr& expr) {
  return expr.kind == TypedExpr::Kind::kCall &&
         (expr.builtin == Builtin::kTopicIn || expr.builtin == Builtin::kTopicMatches ||
          expr.builtin == Builtin::kMsgTypeIn || expr.builtin == Builtin::kMsgSubtype) &&
         AllConstant(expr.args);
}

absl::StatusOr<std::unique_ptr<const RE2>> CompileRegex(const TypedExpr& call) {
  const std::string* pattern =
      call.args.size() == 1 ? std::get_if<std::string>(&call.args[0].constant) : nullptr;
  if (pattern == nullptr || call.args[0].kind != TypedExpr::Kind::kConstant) {
    return absl::InvalidArgumentError("`topicmatches` takes one constant string");
  }
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(kRegexBytesMax);
  auto regex = std::make_unique<const RE2>(*pattern, options);
  if (!regex->ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat("`topicmatches(\"", *pattern, "\")`: ", regex->error()));
  }
  return regex;
}

// Equal for calls that ask the same.
std::string KeyOf(const TypedExpr& call) {
  std::string key = absl::StrCat(static_cast<int>(call.builtin));
  for (const TypedExpr& arg : call.args) {
    const auto* text = std::get_if<std::string>(&arg.constant);
    if (text != nullptr) absl::StrAppend(&key, "|", text->size(), ":", *text);
  }
  return key;
}

class Compiler {
 public:
  explicit Compiler(const lang::CheckedRules& rules) : rules_(rules) {}

  absl::StatusOr<std::unique_ptr<const Program::Compiled>> Run() {
    for (uint32_t i = 0; i < rules_.variables.size(); ++i) {
      out_->variable_of.emplace(rules_.variables[i].name, i);
    }
    out_->holds_level.resize(rules_.variables.size());
    for (uint32_t i = 0; i < rules_.rules.size(); ++i) {
      if (absl::Status status = AddRule(i); !status.ok()) return status;
    }
    return std::move(out_);
  }

 private:
  absl::Status AddRule(uint32_t index) {
    const lang::TypedRule& rule = rules_.rules[index];
    absl::Status status = AddExpr(rule.condition);
    for (const lang::TypedChain& chain : rule.chains) {
      for (const lang::TypedAction& action : chain) {
        for (const TypedExpr& arg : action.args) status.Update(AddExpr(arg));
        NoteLevelVariable(action);
      }
    }
    if (!status.ok()) {
      return absl::Status(status.code(),
                          absl::StrCat("rule `", rule.name, "`: ", status.message()));
    }
    if (NeverFires(rule.condition)) return absl::OkStatus();
    switch (rule.section) {
      case EventClass::kMsg:
        out_->message_rules.push_back(index);
        break;
      case EventClass::kGraph:
        out_->graph_rules.push_back(index);
        break;
      case EventClass::kExternal:
        out_->external_rules.push_back(index);
        break;
      case EventClass::kUniversal:
        return absl::InvalidArgumentError(absl::StrCat("rule `", rule.name, "` has no section"));
    }
    return absl::OkStatus();
  }

  // Without recursion: a long run of operators is as deep as it is long.
  absl::Status AddExpr(const TypedExpr& root) {
    std::vector<const TypedExpr*> todo = {&root};
    while (!todo.empty()) {
      const TypedExpr& expr = *todo.back();
      todo.pop_back();
      for (const TypedExpr& arg : expr.args) todo.push_back(&arg);
      if (IsTopicPredicate(expr)) {
        if (absl::Status status = AddPredicate(expr); !status.ok()) return status;
      } else if (expr.kind == TypedExpr::Kind::kCall && expr.builtin == Builtin::kTopicMatches) {
        return absl::InvalidArgumentError("`topicmatches` takes one constant string");
      }
    }
    return absl::OkStatus();
  }

  absl::Status AddPredicate(const TypedExpr& call) {
    const auto [known, added] =
        known_.emplace(KeyOf(call), static_cast<uint32_t>(out_->predicates.size()));
    out_->predicate_of.emplace(&call, known->second);
    if (!added) return absl::OkStatus();
    TopicPredicate predicate{.builtin = call.builtin};
    for (const TypedExpr& arg : call.args) {
      const auto* text = std::get_if<std::string>(&arg.constant);
      if (text == nullptr) return absl::InvalidArgumentError("a topic predicate takes strings");
      predicate.args.emplace_back(absl::string_view(*text));
    }
    if (call.builtin == Builtin::kTopicMatches) {
      absl::StatusOr<std::unique_ptr<const RE2>> regex = CompileRegex(call);
      if (!regex.ok()) return regex.status();
      predicate.regex = *std::move(regex);
    }
    out_->predicates.push_back(std::move(predicate));
    return absl::OkStatus();
  }

  void NoteLevelVariable(const lang::TypedAction& action) {
    if (action.kind != lang::ActionKind::kTrigger || action.args.size() != 1) return;
    const TypedExpr& arg = action.args[0];
    if (arg.kind != TypedExpr::Kind::kVariable || arg.variable >= out_->holds_level.size()) return;
    out_->holds_level[arg.variable] = true;
  }

  const lang::CheckedRules& rules_;
  std::unique_ptr<Program::Compiled> out_ = std::make_unique<Program::Compiled>();
  absl::flat_hash_map<std::string, uint32_t> known_;
};

}  // namespace

Program::Program(lang::CheckedRules rules) : rules_(std::move(rules)) {}
Program::~Program() = default;

absl::StatusOr<std::shared_ptr<const Program>> Program::Create(lang::CheckedRules rules) {
  std::shared_ptr<Program> program(new Program(std::move(rules)));
  // Predicates view the rules where they now stand.
  absl::StatusOr<std::unique_ptr<const Compiled>> compiled = Compiler(program->rules_).Run();
  if (!compiled.ok()) return compiled.status();
  program->compiled_ = *std::move(compiled);
  return program;
}

}  // namespace rips::engine
