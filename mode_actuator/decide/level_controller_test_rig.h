// An LevelController with a clock, a disk and a robot that do as the test says. Test code only.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_LEVEL_CONTROLLER_TEST_RIG_H_
#define RIPS_MODE_ACTUATOR_DECIDE_LEVEL_CONTROLLER_TEST_RIG_H_

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/level_controller.h"

namespace rips::actuator {

class ExecutorRig {
 public:
  static constexpr int64_t kMs = kNanosPerMilli;

  static ExecutorOptions Options() {
    return {.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"}, .fail_safe = "ALERT"};
  }
  // As above, of a robot whose modes can be read back.
  static ExecutorOptions WithSurvey() {
    ExecutorOptions options = Options();
    options.survey = true;
    return options;
  }
  static ActuatorState At(const std::string& level, DecisionId decision_id = {1, 1}) {
    return {.decision_id = decision_id,
            .decided = level,
            .effective = level,
            .highest_term = decision_id.term};
  }

  explicit ExecutorRig(absl::StatusOr<ActuatorState> loaded = At("DEFAULT"),
                       ExecutorOptions options = Options())
      : executor_(*LevelController::Create(options, loaded, now_ns_)), options_(options) {
    if (loaded.ok()) disk_ = EncodeState(*loaded);
    Do(executor_.Start(now_ns_));
  }

  // --- what the test turns
  bool auto_finish = true;    // jobs end at once, reaching the level
  bool robot_reaches = true;  // what they end with
  bool auto_persist = true;   // writes end at once
  bool disk_works = true;
  bool lease = false;  // a lease every 500 ms
  bool evidence = true;
  uint64_t term = 1;
  std::string robot;  // the level that was reached last; empty before the first

  // --- inputs
  void Level(const std::string& to, DecisionId decision_id, DecisionId based_on = {},
             std::string id = "", uint64_t command_term = 0) {
    if (id.empty()) id = absl::StrCat("id-", ToString(decision_id));
    if (command_term == 0) command_term = std::max(term, decision_id.term);
    Do(executor_.OnSetLevel(
        {.id = id,
         .term = command_term,
         .what = model::SetLevel{.decision_id = decision_id, .to = to, .based_on = based_on}},
        now_ns_));
  }
  bool Grant(int64_t echo_age_ms = 0, uint32_t ttl_ms = 15'000) {
    return executor_.OnLease({.echo_boottime_ns = now_ns_ - echo_age_ms * kMs,
                              .term = term,
                              .ttl_ms = ttl_ms,
                              .evidence_complete = evidence},
                             now_ns_);
  }
  void Advance(int64_t ms) {
    for (int64_t passed = 0; passed < ms; passed += 50) {
      now_ns_ += 50 * kMs;
      if (lease && passed % 500 == 0) Grant();
      Do(executor_.OnTick(now_ns_));
    }
  }
  void Finish(bool reached, std::string detail = "") {
    ASSERT_TRUE(job_.has_value()) << "no job is running";
    const ApplyLevel job = *std::exchange(job_, std::nullopt);
    FinishJob(job, reached, std::move(detail));
  }
  void FinishJob(const ApplyLevel& job, bool reached, std::string detail = "") {
    if (reached && job.kind != JobKind::kCheck) robot = job.to;
    Do(executor_.OnOutcome({.attempt = job.attempt,
                            .reached = reached,
                            .detail = std::move(detail),
                            .observed = absl::StrCat("/safety=", reached ? job.to : "?")},
                           now_ns_));
  }
  // The survey that was begun last ends; the robot shows the level `shown`, or none.
  void FinishSurvey(const std::string& shown) {
    ASSERT_TRUE(survey_.has_value()) << "no survey was begun";
    const ApplyLevel survey = *std::exchange(survey_, std::nullopt);
    Do(executor_.OnOutcome({.attempt = survey.attempt,
                            .kind = JobKind::kSurvey,
                            .reached = !shown.empty(),
                            .observed = absl::StrCat("/safety=", shown.empty() ? "?" : shown),
                            .shown = shown},
                           now_ns_));
  }
  void FinishWrite(absl::Status status = absl::OkStatus()) {
    ASSERT_FALSE(writes_.empty());
    const PersistState write = writes_.front();
    writes_.erase(writes_.begin());
    if (status.ok()) disk_ = EncodeState(write.state);
    Do(executor_.OnPersisted(write.sequence, status, now_ns_));
  }
  // What a new process would find.
  ExecutorRig Restarted() const {
    return ExecutorRig(disk_.empty() ? absl::StatusOr<ActuatorState>(absl::NotFoundError("none"))
                                     : DecodeState(disk_),
                       options_);
  }

  // --- what came of it
  ExecutorReport report() const { return executor_.Report(now_ns_); }
  const std::optional<ApplyLevel>& job() const { return job_; }
  const std::optional<ApplyLevel>& survey() const { return survey_; }
  const std::vector<PersistState>& writes() const { return writes_; }
  std::optional<ActuatorState> disk() const {
    const auto state = DecodeState(disk_);
    return state.ok() ? std::optional<ActuatorState>(*state) : std::nullopt;
  }
  // "COMPROMISED enter, ..." of everything begun since the last call, checks left out.
  std::string PopJobs() { return std::exchange(jobs_, ""); }
  // "id-1.2 acknowledged" since the last call.
  std::vector<std::string> PopReceipts() { return std::exchange(receipts_, {}); }
  // "apply COMPROMISED", "write", "id-1.2 acknowledged" in order, since the last call.
  std::vector<std::string> PopOrder() { return std::exchange(order_, {}); }
  std::string last_detail() const { return last_detail_; }
  LevelController& executor() { return executor_; }
  int64_t now_ns() const { return now_ns_; }

 private:
  static std::string StageName(Receipt::Stage stage) {
    static constexpr const char* kNames[] = {"?",          "acknowledged",  "verified", "failed",
                                             "superseded", "refused_stale", "refused",  "unknown"};
    return kNames[static_cast<int>(stage)];
  }

  void Do(const Actions& actions) {
    for (const Action& action : actions) {
      const auto* apply = std::get_if<ApplyLevel>(&action);
      if (apply != nullptr && apply->kind == JobKind::kSurvey) {
        survey_ = *apply;
        order_.push_back("survey");
      } else if (apply != nullptr) {
        job_ = *apply;
        if (apply->kind != JobKind::kCheck) {
          absl::StrAppend(&jobs_, jobs_.empty() ? "" : ", ", apply->from, ">", apply->to,
                          apply->kind == JobKind::kRetry ? " retry" : "",
                          apply->kind == JobKind::kOnDrift ? " on_drift" : "",
                          apply->raise ? "" : " down");
        }
        order_.push_back(absl::StrCat("apply ", apply->to));
      } else if (const auto* write = std::get_if<PersistState>(&action)) {
        writes_.push_back(*write);
        order_.push_back("write");
      } else {
        const Receipt& receipt = std::get<SendReceipt>(action).receipt;
        receipts_.push_back(absl::StrCat(receipt.command_id, " ", StageName(receipt.stage)));
        order_.push_back(receipts_.back());
        last_detail_ = receipt.detail;
      }
    }
    while (auto_persist && !writes_.empty()) {
      FinishWrite(disk_works ? absl::OkStatus() : absl::UnavailableError("disk full"));
    }
    while (auto_finish && job_.has_value()) Finish(robot_reaches, robot_reaches ? "" : "lies");
  }

  int64_t now_ns_ = 1'000 * kNanosPerSecond;
  LevelController executor_;
  ExecutorOptions options_;
  std::optional<ApplyLevel> job_;
  std::optional<ApplyLevel> survey_;
  std::vector<PersistState> writes_;
  std::string disk_;
  std::string jobs_;
  std::vector<std::string> receipts_;
  std::vector<std::string> order_;
  std::string last_detail_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_LEVEL_CONTROLLER_TEST_RIG_H_
