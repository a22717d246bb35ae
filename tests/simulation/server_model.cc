#include "tests/simulation/server_model.h"

#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/lang/check/compile.h"
#include "services/base/check.h"

namespace rips::simulation {
namespace {

// `judged` counts the observations that the checker follows, in the same instant in which their
// sequence counts as judged.
constexpr char kRules[] = R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
vars:
  intruder bool = false;
  judged int = 0;
rules Graph:
  unknown_node: !nodesinclude("/camera", "/navigator", "/rips") ?
    set(intruder, true) => alert("unknown node", "high") => trigger(ALERT);
  known_nodes: nodesinclude("/camera", "/navigator", "/rips") && intruder ? set(intruder, false);
rules Msg:
  moved: topicin("/cmd_vel") ? set(judged, judged + 1);
  rogue: topicin("/cmd_vel") && !publishers("/navigator") ?
    alert("rogue cmd_vel", "critical") => trigger(COMPROMISED);
rules External:
  probed: idsalert("probe") ? set(judged, judged + 1) => alert("probe", "low");
  counted: false ? set(judged, judged);
  stop: signal("SIGUSR1") ? trigger(HALT);
  quiet: CurrLevel == ALERT && !intruder ? trigger(DEFAULT);
)";

std::shared_ptr<const engine::CompiledPolicy> Compile() {
  const std::vector<lang::SourceFile> files = {{.path = "simulation.rul", .text = kRules}};
  lang::CompileResult compiled = lang::Compile(files);
  RIPS_CHECK(compiled.rules.has_value(), "the simulation's rules do not compile");
  auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
  RIPS_CHECK(program.ok(), "the simulation's rules are refused");
  return *program;
}

// Tells the checker what is judged.
class JudgedTap final : public pipeline::EventRecorder {
 public:
  explicit JudgedTap(Checker* checker) : checker_(*checker) {}
  bool OnLevel(const pipeline::LevelChange&) override { return true; }
  bool OnEvent(const pipeline::JudgedEvent& judged) override {
    if (judged.message != nullptr) checker_.OnJudged(judged.message->size_bytes);
    const auto* external = std::get_if<engine::ExternalEvent>(&judged.event.what);
    if (external == nullptr) return true;
    const auto* ids = std::get_if<model::IdsAlert>(external);
    if (ids != nullptr) checker_.OnJudged(ids->sid);
    return true;
  }

 private:
  Checker& checker_;
};

}  // namespace

void ServerModel::Start() {
  static const auto* program = new std::shared_ptr<const engine::CompiledPolicy>(Compile());
  store_.Open();
  const auto [record, term] = store_.Acquire();
  context_.checker.OnServerStart(context_.scheduler.now_ns());
  auto robot = pipeline::Robot::Create(
      {.id = "r1", .sensor_hosts = {kHost}, .primary_sensor = kHost, .actuator_hosts = {kHost}},
      {.program = *program,
       .bundle_id = "sha256:0",
       .soft_hold_ns = kSoftHoldNs,
       .two_person = {"HALT"}},
      pipeline::Timing{.lease_ns = 3 * kNanosPerSecond}, record, term, MakePorts());
  RIPS_CHECK(robot.ok(), "the robot's record is refused");
  robot_ = *std::move(robot);
  (void)robot_->AddTap(std::make_shared<JudgedTap>(&context_.checker));
  context_.trace.Add("server", absl::StrCat("starts with term ", term, " at ", record.level, " (",
                                            ToString(record.decision_id), ")"));
  Tick();
}

void ServerModel::Crash() {
  context_.trace.Add("server", "crashes");
  ++life_;
  posted_.clear();
  posted_work_.clear();
  running_posted_ = false;
  robot_.reset();
}

pipeline::Ports ServerModel::MakePorts() {
  return {.clock = &context_.scheduler.clock(),
          .recorder = &store_,
          .audience = this,
          .post = [this](std::function<void()> task) { Post(&posted_, std::move(task)); },
          .post_work = [this](std::function<void()> task) { Post(&posted_work_, std::move(task)); },
          .new_id = [this] { return absl::StrFormat("%032x", ++ids_); }};
}

void ServerModel::Post(std::deque<std::function<void()>>* line, std::function<void()> task) {
  line->push_back(std::move(task));
  if (running_posted_) return;
  running_posted_ = true;
  context_.scheduler.After(context_.scheduler.Between(0, 2'000) * 1'000, [this, life = life_] {
    if (life == life_) RunPosted();
  });
}

void ServerModel::RunPosted() {
  running_posted_ = false;
  while (!posted_.empty() || !posted_work_.empty()) {
    std::deque<std::function<void()>>& line = posted_.empty() ? posted_work_ : posted_;
    const std::function<void()> task = std::move(line.front());
    line.pop_front();
    task();
  }
}

void ServerModel::Call(uint64_t life, const std::function<void(pipeline::Robot&)>& call) {
  if (!up() || life != life_) return;
  call(*robot_);
  while (robot_->HasControl() || robot_->HasMessages()) robot_->Advance();
}

void ServerModel::Tick() {
  Call(life_, [](pipeline::Robot& robot) { robot.OnTime(); });
  context_.scheduler.After(50 * kMs, [this, life = life_] {
    if (life == life_) Tick();
  });
}

void ServerModel::OnAlert(const store::AlertRecord& alert) {
  context_.checker.OnAlertTold(alert.id);
}

}  // namespace rips::simulation
