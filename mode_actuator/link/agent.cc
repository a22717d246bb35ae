#include "mode_actuator/link/agent.h"

#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <functional>
#include <optional>
#include <thread>
#include <utility>
#include <variant>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "mode_actuator/decide/degraded_status.h"
#include "mode_actuator/decide/drill_controller.h"
#include "mode_actuator/decide/exec_journal.h"
#include "mode_actuator/decide/receipt_queue.h"
#include "mode_actuator/decide/status_line.h"
#include "mode_actuator/link/audit_head_file.h"
#include "mode_actuator/link/downlink.h"
#include "mode_actuator/steps/alarm/alarm_board.h"
#include "mode_actuator/steps/alarm/drivers.h"
#include "mode_actuator/steps/drill.h"
#include "mode_actuator/steps/firewall/fw_client.h"
#include "mode_actuator/steps/level_executor.h"
#include "mode_actuator/steps/program/exec_client.h"
#include "mode_actuator/steps/system_mode/system_modes.h"
#include "mode_actuator/steps/workers.h"
#include "services/base/ids.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/dds/node_announcer.h"
#include "services/dds/participant.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/file_lock.h"
#include "services/runtime/log.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kTick = absl::Milliseconds(50);
constexpr size_t kInputsMax = 4096;
constexpr size_t kFileTasksMax = 256;

// Events from other threads to the agent's thread.
struct Connected {};
struct Persisted {
  uint64_t sequence = 0;
  absl::Status status;
};
struct ExecJournalled {
  model::Command command;
  absl::Status status;
};
struct ExecEnded {
  std::string id;
  ProgramResult result;
};
using Input = std::variant<model::Command, model::LeaseGrant, Connected, LevelOutcome, DrillOutcome,
                           Persisted, ExecJournalled, ExecEnded>;

ExecutorOptions MakeExecutorOptions(const Config& config) {
  ExecutorOptions options;
  for (const LevelSpec& level : config.levels) options.levels.push_back(level.name);
  for (const LevelSpec& level : config.levels) {
    if (!level.on_drift.empty()) options.on_drift.insert(level.name);
  }
  options.survey = !ModeTargets(config.levels).empty();
  if (config.fail_safe_level != "keep") options.fail_safe = config.fail_safe_level;
  options.fail_safe_after_ns = absl::ToInt64Nanoseconds(config.fail_safe_after);
  options.floor_hold_ns = absl::ToInt64Nanoseconds(config.floor_hold);
  options.reconcile_ns = absl::ToInt64Nanoseconds(config.reconcile);
  return options;
}

absl::string_view StageName(Receipt::Stage stage) {
  switch (stage) {
    case Receipt::Stage::kAcknowledged:
      return "acknowledged";
    case Receipt::Stage::kVerified:
      return "verified";
    case Receipt::Stage::kFailed:
      return "failed";
    case Receipt::Stage::kSuperseded:
      return "superseded";
    case Receipt::Stage::kRefusedStale:
      return "refused_stale";
    case Receipt::Stage::kRefused:
      return "refused";
    case Receipt::Stage::kUnknown:
      return "unknown";
  }
  return "?";
}

Receipt::Stage NotBegunStage(const absl::Status& why) {
  return absl::IsUnavailable(why) ? Receipt::Stage::kFailed : Receipt::Stage::kRefused;
}

Receipt::Stage EndedStage(const ProgramResult& result) {
  if (result.status.ok()) return Receipt::Stage::kVerified;
  if (absl::IsUnknown(result.status)) return Receipt::Stage::kUnknown;
  return result.begun ? Receipt::Stage::kFailed : NotBegunStage(result.status);
}

absl::Status MakeDirectory(const std::string& path) {
  struct stat info;
  if (mkdir(path.c_str(), 0700) == 0) return absl::OkStatus();
  if (errno == EEXIST && stat(path.c_str(), &info) == 0 && S_ISDIR(info.st_mode)) {
    return absl::OkStatus();
  }
  return absl::UnavailableError(
      absl::StrCat("cannot make the state directory `", path, "`: ", std::strerror(errno)));
}

void LogOutcome(const LevelOutcome& outcome) {
  if (outcome.kind == JobKind::kSurvey) {
    LogInfo("surveyed the robot", {{"observed", outcome.observed},
                                   {"level", outcome.shown.empty() ? "none" : outcome.shown}});
  } else if (!outcome.reached) {
    LogWarning("not reached", {{"detail", outcome.detail}});
  }
}

void LogDegraded(const std::vector<std::string>& before, const std::vector<std::string>& now) {
  for (const std::string& text : now) {
    if (std::find(before.begin(), before.end(), text) != before.end()) continue;
    LogWarning("degraded", {{"why", text}});
  }
  if (now.empty() && !before.empty()) LogInfo("no longer degraded");
}

struct Counters {
  Gauge effective, verified, floor, lease_live;
  Counter commands, receipts_failed, receipts_refused, malformed, dropped, write_failures;
  Gauge drifts, firewall_dropped, alarms_missing, announced, helpers_refused;
};

Counters MakeCounters(Metrics* m) {
  return {
      .effective = m->AddGauge("rips_actuator_effective_level", "index of the effective level"),
      .verified = m->AddGauge("rips_actuator_verified", "1 = the effective level was read back"),
      .floor = m->AddGauge("rips_actuator_floor", "1 = a floor of our own holds"),
      .lease_live = m->AddGauge("rips_actuator_lease_live", "1 = the server's lease is live"),
      .commands = m->AddCounter("rips_actuator_commands_total", "commands received"),
      .receipts_failed = m->AddCounter("rips_actuator_failed_total", "commands that failed"),
      .receipts_refused = m->AddCounter("rips_actuator_refused_total", "commands refused"),
      .malformed = m->AddCounter("rips_actuator_malformed_total", "commands not understood"),
      .dropped = m->AddCounter("rips_actuator_inputs_dropped_total", "inputs lost to the limit"),
      .write_failures = m->AddCounter("rips_actuator_write_failures_total", "failed file writes"),
      .drifts = m->AddGauge("rips_actuator_drifts", "times a verified level was found left"),
      .firewall_dropped = m->AddGauge("rips_actuator_firewall_dropped_packets",
                                      "dropped on their way in since the level was entered"),
      .alarms_missing =
          m->AddGauge("rips_actuator_alarms_missing", "alarm devices that cannot be used"),
      .announced =
          m->AddGauge("rips_actuator_announced", "1 = announced to ROS tools as the node /rips"),
      .helpers_refused = m->AddGauge("rips_actuator_helpers_refused",
                                     "helpers whose socket another process may have made"),
  };
}

absl::StatusOr<std::unique_ptr<dds::Participant>> Join(const Config& config, const Clock* clock) {
  RIPS_ASSIGN_OR_RETURN(std::optional<dds::Enclave> enclave,
                        dds::LoadSecurity(config.dds, absl::FromUnixNanos(clock->Now().unix_ns)));
  return dds::Participant::Create(
      dds::DomainOptions{.id = config.dds.domain, .interface = config.dds.interface},
      {.security = std::move(enclave)});
}

}  // namespace

class Agent::Impl {
 public:
  Impl(Config config, const Clock* clock, Metrics* metrics)
      : config_(std::move(config)),
        clock_(clock),
        counters_(MakeCounters(metrics)),
        audit_head_(absl::StrCat(config_.state_dir, "/audit_head"), counters_.write_failures),
        inputs_({.capacity = kInputsMax}),
        drills_(MakeExecutorOptions(config_).levels) {}

  ~Impl();
  absl::Status Start(const LoadedConfig& loaded, rpc::CredentialsSource credentials,
                     rpc::CertificateMonitor* monitor, std::function<void()> on_turn);
  const absl::Status& modes_problem() const { return modes_problem_; }
  dds::InterfacesInUse interfaces() const {
    return participant_ != nullptr ? participant_->interfaces() : dds::InterfacesInUse();
  }
  absl::Status Ready() const ABSL_LOCKS_EXCLUDED(report_mu_);
  std::string Describe() const ABSL_LOCKS_EXCLUDED(report_mu_);

 private:
  std::string StatePath() const { return absl::StrCat(config_.state_dir, "/state"); }
  std::string JournalPath() const { return absl::StrCat(config_.state_dir, "/journal"); }
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  absl::Status LoadState();
  absl::Status StartModes(const Smh& smh);
  void StartAnnouncing();
  void StartWorkers();
  PartModes* Modes() {
    return modes_ != nullptr ? modes_.get() : static_cast<PartModes*>(&missing_);
  }
  void StartDownlink(const LoadedConfig& loaded, rpc::CredentialsSource credentials,
                     rpc::CertificateMonitor* monitor);
  void PushFromNetwork(Input input);

  // The agent's thread.
  void Loop(const std::function<void()>& on_turn);
  void Handle(Input input, int64_t now_ns);
  void Do(Actions actions, int64_t now_ns);
  void QueueReceipt(Receipt receipt);
  void OnDrill(const model::Command& command);
  void OnRunProgram(const model::Command& command);
  void OnExecJournalled(const ExecJournalled& journalled);
  void OnExecEnded(const ExecEnded& ended);
  void EndExec(Receipt receipt);
  bool IsAllowed(absl::string_view program) const;
  void WriteJournal(std::function<void(const absl::Status&)> done);
  void Publish(int64_t now_ns) ABSL_LOCKS_EXCLUDED(report_mu_);
  void Announce(int64_t now_ns);
  absl::Status FindHelpers();
  void CheckHelpers(int64_t now_ns);

  const Config config_;
  const Clock* const clock_;  // Not owned; outlives this.
  const Counters counters_;
  AuditHeadFile audit_head_;
  BoundedQueue<Input> inputs_;

  // Of the agent's thread.
  std::optional<LevelController> controller_;
  ExecJournal journal_;
  DrillController drills_;
  ReceiptQueue receipts_;
  DegradedStatus degraded_;
  size_t execs_ = 0;
  int64_t heartbeat_sent_ns_ = 0;
  bool announcing_ = true;  // the last claim was published
  int64_t check_helpers_at_ns_ = 0;

  UniqueFd state_lock_;  // two actuators would fight for the same parts

  mutable Mutex report_mu_;
  ExecutorReport report_ ABSL_GUARDED_BY(report_mu_);
  absl::Status disconnected_ ABSL_GUARDED_BY(report_mu_);  // why the last stream ended

  // In the order of dependence; what is last goes first.
  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<SystemModes> modes_;
  // Null if it is not to announce, or may not, or is not on the bus.
  std::unique_ptr<dds::NodeAnnouncer> announcer_;
  absl::Status modes_problem_;  // of the start
  MissingModes missing_;
  std::unique_ptr<ExecClient> programs_;  // killed at the end; the journal says "begun"
  std::unique_ptr<AlarmBoard> alarms_;    // none if there are no devices
  std::unique_ptr<FwClient> firewall_;
  std::unique_ptr<LevelExecutor> executor_;
  std::unique_ptr<Drill> drill_;
  std::unique_ptr<FileWorker> files_;
  std::unique_ptr<LevelWorker> levels_;
  std::unique_ptr<Downlink> downlink_;
  std::thread thread_;
};

// --- start and end

absl::Status Agent::Impl::LoadState() {
  RIPS_RETURN_IF_ERROR(MakeDirectory(config_.state_dir));
  absl::StatusOr<UniqueFd> lock = LockFile(absl::StrCat(config_.state_dir, "/lock"));
  if (absl::IsFailedPrecondition(lock.status())) {
    return absl::FailedPreconditionError(
        absl::StrCat("another actuator uses the state directory `", config_.state_dir,
                     "`; two would order the same parts: stop that one first"));
  }
  RIPS_RETURN_IF_ERROR(lock.status());
  state_lock_ = *std::move(lock);
  absl::StatusOr<ActuatorState> state = absl::NotFoundError("no state file");
  if (absl::StatusOr<std::string> bytes = ReadFile(StatePath(), kStateBytesMax); bytes.ok()) {
    state = DecodeState(*bytes);
  } else {
    state = bytes.status();
  }
  if (!state.ok()) LogWarning("state lost", {{"why", state.status().message()}});
  RIPS_ASSIGN_OR_RETURN(LevelController controller,
                        LevelController::Create(MakeExecutorOptions(config_), state, NowNs()));
  controller_.emplace(std::move(controller));

  const absl::StatusOr<std::string> journal = ReadFile(JournalPath(), kJournalBytesMax);
  if (journal.ok()) {
    absl::StatusOr<ExecJournal> decoded = ExecJournal::Decode(*journal);
    if (decoded.ok()) {
      journal_ = *std::move(decoded);
    } else {
      LogError("journal lost", {{"why", decoded.status().message()}});
    }
  }
  for (Receipt& receipt : journal_.CloseUnfinished()) QueueReceipt(std::move(receipt));
  audit_head_.Load();
  return absl::OkStatus();
}

absl::Status Agent::Impl::StartModes(const Smh& smh) {
  const SystemModes::Targets targets = ModeTargets(config_.levels);
  if (targets.empty()) return absl::OkStatus();
  auto joined = Join(config_, clock_);
  if (!joined.ok()) {
    modes_problem_ = joined.status();
    missing_.set_why(modes_problem_);
    LogError("System Modes unreachable; entering levels without them until they respond",
             {{"reason", modes_problem_.message()}});
    degraded_.Set("modes", {absl::StrCat("no System Modes: ", modes_problem_.message())});
    return absl::OkStatus();
  }
  participant_ = *std::move(joined);
  RIPS_ASSIGN_OR_RETURN(
      modes_, SystemModes::Create(participant_.get(), smh, config_.modes, targets, clock_));
  if (config_.dds.announce) StartAnnouncing();
  return absl::OkStatus();
}

void Agent::Impl::StartAnnouncing() {
  // All its endpoints are there by now.
  dds::NodeAnnouncerOptions options = dds::AnnouncerOptions(config_.dds);
  options.listen = true;
  auto announcer = dds::NodeAnnouncer::Create(*participant_, std::move(options), NowNs());
  if (!announcer.ok()) {
    LogWarning(
        "this actuator cannot announce itself to ROS, whose tools show its clients without a node; "
        "under DDS Security its permissions must let it publish ros_discovery_info",
        {{"error", announcer.status().ToString()}});
    return;
  }
  announcer_ = *std::move(announcer);
  counters_.announced.Set(1);
  if (const absl::Status& reading = announcer_->reading_status(); !reading.ok()) {
    LogWarning(
        "this actuator cannot read how others announce themselves to ROS; it does so as Humble "
        "does; see `dds: {gid_bytes}`",
        {{"error", reading.ToString()}});
  }
}

absl::Status Agent::Impl::FindHelpers() {
  RIPS_ASSIGN_OR_RETURN(const std::optional<uid_t> exec_user,
                        FindHelperUser(config_.exec.run_as, "rips-exec", "exec.run_as"));
  RIPS_ASSIGN_OR_RETURN(const std::optional<uid_t> fw_user,
                        FindHelperUser(config_.firewall.run_as, "rips-fw", "firewall.run_as"));
  firewall_ = std::make_unique<FwClient>(config_.firewall.socket, fw_user);
  programs_ = std::make_unique<ExecClient>(
      ExecClient::Options{.socket = config_.exec.socket, .run_as = exec_user});
  return absl::OkStatus();
}

// Before a level needs them: a process that poses as a helper is reported at once.
void Agent::Impl::CheckHelpers(int64_t now_ns) {
  if (now_ns < check_helpers_at_ns_) return;
  check_helpers_at_ns_ = now_ns + kNanosPerSecond;
  std::vector<std::string> refused;
  const auto check = [&](const absl::Status& status) {
    if (!status.ok()) refused.emplace_back(status.message());
  };
  if (!config_.programs.empty()) check(programs_->CheckSocket());
  if (HasFirewallSteps(config_.levels)) check(firewall_->CheckSocket());
  counters_.helpers_refused.Set(static_cast<double>(refused.size()));
  degraded_.Set("helpers", std::move(refused));
}

void Agent::Impl::Announce(int64_t now_ns) {
  if (announcer_ == nullptr) return;
  const absl::Status told = announcer_->Poll(now_ns);
  if (told.ok() == announcing_) return;
  announcing_ = told.ok();
  counters_.announced.Set(announcing_ ? 1 : 0);
  if (announcing_) return;
  LogWarning("this actuator's node was not announced; trying again", {{"error", told.ToString()}});
}

void Agent::Impl::StartWorkers() {
  if (!config_.devices.empty()) {
    alarms_ = std::make_unique<AlarmBoard>(config_.devices, RealAlarms(), clock_);
  }
  const StepPorts ports = {.modes = Modes(),
                           .programs = programs_.get(),
                           .alarms = alarms_.get(),
                           .firewall = firewall_.get(),
                           .clock = clock_,
                           .allowed = &config_.programs,
                           .devices = &config_.devices};
  executor_ = std::make_unique<LevelExecutor>(&config_.levels, ports);
  drill_ = std::make_unique<Drill>(config_.levels, ports);
  files_ = std::make_unique<FileWorker>(kFileTasksMax);
  LevelWorker::Callbacks callbacks;
  callbacks.done = [this](LevelOutcome outcome) {
    if (modes_ != nullptr) degraded_.Set("modes", modes_->Degraded());
    inputs_.Push(std::move(outcome));
  };
  if (modes_ != nullptr) {
    callbacks.idle_check = [this] { return modes_->CheckAvailable(); };
    callbacks.idle_checked = [this](const absl::Status&) {
      degraded_.Set("modes", modes_->Degraded());
    };
  }
  levels_ = std::make_unique<LevelWorker>(executor_.get(), std::move(callbacks));
}

void Agent::Impl::StartDownlink(const LoadedConfig& loaded, rpc::CredentialsSource credentials,
                                rpc::CertificateMonitor* monitor) {
  Downlink::Options options;
  if (monitor != nullptr) {
    options.on_peer = [monitor](const rpc::Peer& peer) { monitor->Seen(peer); };
  }
  options.servers = config_.servers;
  options.credentials = std::move(credentials);
  options.host = config_.host;
  options.settings = loaded.settings;
  options.incarnation = absl::HexStringToBytes(NewId());
  for (const LevelSpec& level : config_.levels) options.levels.push_back(level.name);
  options.fail_safe_level = config_.fail_safe_level;
  for (const ProgramSpec& program : config_.programs) {
    if (!program.script) options.programs.push_back(program.name);
  }
  options.protected_parts = ProtectedParts(config_.levels, loaded.smh, config_.modes.backend);
  options.inactive_parts = InactiveParts(config_.levels, loaded.smh, options.protected_parts);
  options.published_while_inactive = config_.published_while_inactive;
  if (participant_ != nullptr) options.participant = participant_->guid();

  Downlink::Callbacks callbacks;
  callbacks.connected = [this] {
    inputs_.Push(Connected{});
    LogInfo("connected");
    MutexLock lock(&report_mu_);
    return report_;
  };
  callbacks.audit_head = [this] { return audit_head_.head(); };
  callbacks.command = [this](model::Command command) { PushFromNetwork(std::move(command)); };
  callbacks.lease = [this](model::LeaseGrant lease) { PushFromNetwork(std::move(lease)); };
  callbacks.malformed = [this](const absl::Status& status) {
    counters_.malformed.Increment();
    LogWarning("malformed command", {{"why", status.message()}});
  };
  // The same again and again is said once.
  callbacks.disconnected = [this](const absl::Status& status) {
    MutexLock lock(&report_mu_);
    const LogLevel level = status == disconnected_ ? LogLevel::kDebug : LogLevel::kWarning;
    Log(level, "disconnected", {{"status", status.ToString()}});
    disconnected_ = status;
  };
  downlink_ = std::make_unique<Downlink>(std::move(options), std::move(callbacks), clock_);
}

absl::Status Agent::Impl::Start(const LoadedConfig& loaded, rpc::CredentialsSource credentials,
                                rpc::CertificateMonitor* monitor, std::function<void()> on_turn) {
  RIPS_RETURN_IF_ERROR(LoadState());
  RIPS_RETURN_IF_ERROR(FindHelpers());
  RIPS_RETURN_IF_ERROR(StartModes(loaded.smh));
  StartWorkers();
  StartDownlink(loaded, std::move(credentials), monitor);
  const int64_t now_ns = NowNs();
  Do(controller_->Start(now_ns), now_ns);
  Publish(now_ns);
  thread_ = std::thread([this, on_turn = std::move(on_turn)] { Loop(on_turn); });
  downlink_->Start();
  return absl::OkStatus();
}

Agent::Impl::~Impl() {
  if (downlink_ != nullptr) downlink_->Stop();
  inputs_.Close();
  if (thread_.joinable()) thread_.join();
  levels_.reset();
  files_.reset();
}

void Agent::Impl::PushFromNetwork(Input input) {
  if (inputs_.size() < kNetworkInputsMax && inputs_.Push(std::move(input))) return;
  counters_.dropped.Increment();
}

// --- the agent's thread

void Agent::Impl::Loop(const std::function<void()>& on_turn) {
  while (true) {
    std::vector<Input> batch = inputs_.PopAll(kTick);
    if (batch.empty() && inputs_.closed()) return;
    for (Input& input : batch) Handle(std::move(input), NowNs());
    const int64_t now_ns = NowNs();
    Do(controller_->OnTick(now_ns), now_ns);
    CheckHelpers(now_ns);
    Publish(now_ns);
    Announce(now_ns);
    if (on_turn) on_turn();
  }
}

void Agent::Impl::Handle(Input input, int64_t now_ns) {
  if (const auto* command = std::get_if<model::Command>(&input)) {
    counters_.commands.Increment();
    std::visit(Overloaded{[&](const model::SetLevel&) {
                            Do(controller_->OnSetLevel(*command, now_ns), now_ns);
                          },
                          [&](const model::RunProgram&) { OnRunProgram(*command); },
                          [&](const model::Drill&) { OnDrill(*command); }},
               command->what);
  } else if (auto* drilled = std::get_if<DrillOutcome>(&input)) {
    QueueReceipt(drills_.OnOutcome(std::move(*drilled)));
  } else if (auto* lease = std::get_if<model::LeaseGrant>(&input)) {
    controller_->OnLease(*lease, now_ns);
    audit_head_.OnLease(lease->audit_head, now_ns, *files_);
  } else if (std::holds_alternative<Connected>(input)) {
    receipts_.NewSession();
  } else if (auto* outcome = std::get_if<LevelOutcome>(&input)) {
    LogOutcome(*outcome);
    Do(controller_->OnOutcome(*outcome, now_ns), now_ns);
  } else if (auto* persisted = std::get_if<Persisted>(&input)) {
    if (!persisted->status.ok()) {
      counters_.write_failures.Increment();
      LogError("cannot write state", {{"why", persisted->status.message()}});
    }
    Do(controller_->OnPersisted(persisted->sequence, persisted->status, now_ns), now_ns);
  } else if (auto* journalled = std::get_if<ExecJournalled>(&input)) {
    OnExecJournalled(*journalled);
  } else if (auto* ended = std::get_if<ExecEnded>(&input)) {
    OnExecEnded(*ended);
  }
}

void Agent::Impl::Do(Actions actions, int64_t now_ns) {
  for (Action& action : actions) {
    if (auto* apply = std::get_if<ApplyLevel>(&action)) {
      if (apply->kind == JobKind::kOnDrift) {
        LogWarning("level drifted repeatedly; running its on_drift steps", {{"level", apply->to}});
      } else if (apply->kind == JobKind::kSurvey) {
        LogInfo("surveying the robot before applying a level");
      } else if (apply->kind != JobKind::kCheck) {
        LogInfo("applying level", {{"from", apply->from}, {"to", apply->to}});
      }
      levels_->Submit(std::move(*apply));
    } else if (auto* persist = std::get_if<PersistState>(&action)) {
      const uint64_t sequence = persist->sequence;
      const bool taken = files_->Submit(
          {StatePath(), EncodeState(persist->state), [this, sequence](const absl::Status& status) {
             inputs_.Push(Persisted{sequence, status});
           }});
      if (!taken) {
        const absl::Status full = absl::ResourceExhaustedError("too many writes wait");
        Do(controller_->OnPersisted(sequence, full, now_ns), now_ns);
      }
    } else {
      QueueReceipt(std::get<SendReceipt>(std::move(action)).receipt);
    }
  }
}

void Agent::Impl::QueueReceipt(Receipt receipt) {
  if (receipt.stage == Receipt::Stage::kFailed) counters_.receipts_failed.Increment();
  if (receipt.stage == Receipt::Stage::kRefused || receipt.stage == Receipt::Stage::kRefusedStale) {
    counters_.receipts_refused.Increment();
  }
  LogInfo("receipt", {{"command", receipt.command_id},
                      {"stage", StageName(receipt.stage)},
                      {"decision_id", ToString(receipt.decision_id)},
                      {"detail", receipt.detail}});
  receipts_.Add(std::move(receipt));
}

void Agent::Impl::Publish(int64_t now_ns) {
  if (alarms_ != nullptr) counters_.alarms_missing.Set(static_cast<double>(alarms_->missing()));
  ExecutorReport report = controller_->Report(now_ns);
  for (std::string& text : degraded_.All()) report.degraded.push_back(std::move(text));
  report.degraded = LimitDegraded(std::move(report.degraded));
  bool changed = false;
  std::vector<std::string> degraded_before;
  {
    MutexLock lock(&report_mu_);
    changed = report_ != report;
    degraded_before = std::move(report_.degraded);
    report_ = report;
  }
  LogDegraded(degraded_before, report.degraded);
  if (changed) {
    const std::vector<std::string>& levels = MakeExecutorOptions(config_).levels;
    for (size_t i = 0; i < levels.size(); ++i) {
      if (levels[i] == report.effective) counters_.effective.Set(static_cast<double>(i));
    }
    counters_.verified.Set(report.verified ? 1 : 0);
    counters_.floor.Set(report.floor.empty() ? 0 : 1);
    counters_.lease_live.Set(report.lease_live ? 1 : 0);
    counters_.drifts.Set(static_cast<double>(report.drifts));
    LogInfo("level", {{"decided", report.decided},
                      {"effective", report.effective},
                      {"verified", report.verified},
                      {"observed", report.observed},
                      {"floor", report.floor},
                      {"floor_reason", report.floor_reason},
                      {"decision_id", ToString(report.decision_id)}});
  }
  // A change is sent at once. It is sent before the receipts, so that no level is reported as
  // verified while the heartbeat still shows the one before.
  if (changed || now_ns >= heartbeat_sent_ns_ + downlink_->heartbeat_ns()) {
    const std::optional<model::FirewallDrops> drops = controller_->FirewallDrops(now_ns);
    counters_.firewall_dropped.Set(drops.has_value() ? static_cast<double>(drops->packets) : 0);
    if (downlink_->SendHeartbeat(report, drops)) heartbeat_sent_ns_ = now_ns;
  }
  receipts_.Flush(now_ns,
                  [this](const Receipt& receipt) { return downlink_->SendReceipt(receipt); });
}

// --- drills

void Agent::Impl::OnDrill(const model::Command& command) {
  const std::string held = controller_->Report(NowNs()).effective;
  const bool admitted = controller_->AdmitTerm(command.term);
  QueueReceipt(drills_.OnCommand(command, admitted, held, [this](const DrillJob& job) {
    return levels_->SubmitDrill(
        [this, job](const CancelFlag& cancel, const std::function<void()>& between) {
          return [this, outcome = drill_->Run(job, cancel, between)] { inputs_.Push(outcome); };
        });
  }));
}

// --- exec

bool Agent::Impl::IsAllowed(absl::string_view program) const {
  const ProgramSpec* spec = FindNamed(config_.programs, program);
  return spec != nullptr && !spec->script;
}

void Agent::Impl::WriteJournal(std::function<void(const absl::Status&)> done) {
  if (files_->Submit({JournalPath(), journal_.Encode(), done})) return;
  if (done) done(absl::ResourceExhaustedError("too many writes wait"));
}

void Agent::Impl::OnRunProgram(const model::Command& command) {
  const std::string& program = std::get<model::RunProgram>(command.what).program;
  Receipt receipt;
  receipt.command_id = command.id;
  receipt.stage = Receipt::Stage::kRefused;
  if (!controller_->AdmitTerm(command.term)) {
    receipt.stage = Receipt::Stage::kRefusedStale;
    receipt.detail = absl::StrCat("term ", command.term, " is stale");
  } else if (std::optional<Receipt> known = journal_.Find(command.id)) {
    receipt = *std::move(known);
  } else if (!IsAllowed(program)) {
    receipt.detail = absl::StrCat("program `", absl::CHexEscape(program.substr(0, 100)),
                                  "` is not in the allow-list");
  } else if (execs_ >= kExecsMax) {
    receipt.detail = absl::StrCat("running programs exceed limit ", kExecsMax);
  } else if (const absl::Status begun = journal_.Begin(command.id); !begun.ok()) {
    receipt.detail = std::string(begun.message());
  } else {
    ++execs_;
    // Begun on the disk before it begins: should we die, it is not run a second time.
    WriteJournal([this, command](const absl::Status& status) {
      inputs_.Push(ExecJournalled{command, status});
    });
    return;
  }
  receipt.effective_level = controller_->Report(NowNs()).effective;
  QueueReceipt(std::move(receipt));
}

void Agent::Impl::OnExecJournalled(const ExecJournalled& journalled) {
  const model::Command& command = journalled.command;
  const auto& program = std::get<model::RunProgram>(command.what);
  Receipt receipt;
  receipt.command_id = command.id;
  if (!journalled.status.ok()) {
    counters_.write_failures.Increment();
    journal_.Forget(command.id);
    --execs_;
    receipt.stage = Receipt::Stage::kRefused;
    receipt.detail = absl::StrCat("cannot be recorded: ", journalled.status.message());
    QueueReceipt(std::move(receipt));
    return;
  }
  const absl::Duration timeout =
      program.timeout_ms > 0 ? absl::Milliseconds(program.timeout_ms) : absl::InfiniteDuration();
  const absl::StatusOr<uint64_t> run =
      programs_->Start({.name = program.program, .args = program.args, .timeout = timeout},
                       [this, id = command.id](ProgramResult result) {
                         inputs_.Push(ExecEnded{id, std::move(result)});
                       });
  if (run.ok()) {
    receipt.stage = Receipt::Stage::kAcknowledged;
    QueueReceipt(std::move(receipt));
    return;
  }
  receipt.stage = NotBegunStage(run.status());
  receipt.detail = std::string(run.status().message());
  EndExec(std::move(receipt));
}

void Agent::Impl::OnExecEnded(const ExecEnded& ended) {
  Receipt receipt;
  receipt.command_id = ended.id;
  receipt.stage = EndedStage(ended.result);
  receipt.exit_code = ended.result.exit_code;
  receipt.output_tail = ended.result.output_tail;
  receipt.detail = ProgramDetail(ended.result);
  EndExec(std::move(receipt));
}

void Agent::Impl::EndExec(Receipt receipt) {
  --execs_;
  journal_.Finish(receipt.command_id, receipt.stage, receipt.exit_code);
  WriteJournal([this](const absl::Status& status) {
    if (!status.ok()) counters_.write_failures.Increment();
  });
  receipt.effective_level = controller_->Report(NowNs()).effective;
  QueueReceipt(std::move(receipt));
}

absl::Status Agent::Impl::Ready() const {
  RIPS_RETURN_IF_ERROR(modes_problem_);
  if (!downlink_->connected()) return absl::UnavailableError("not connected to a policy server");
  MutexLock lock(&report_mu_);
  if (!report_.lease_live) return absl::UnavailableError("no live lease");
  if (!report_.verified) return absl::UnavailableError("the level is not read back");
  return absl::OkStatus();
}

std::string Agent::Impl::Describe() const {
  const bool connected = downlink_->connected();
  MutexLock lock(&report_mu_);
  return StatusLine(report_, connected, disconnected_);
}

// --- Agent

Agent::Agent(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Agent::~Agent() = default;

absl::StatusOr<std::unique_ptr<Agent>> Agent::Start(const LoadedConfig& loaded,
                                                    rpc::CredentialsSource credentials,
                                                    const Clock* clock, Metrics* metrics,
                                                    rpc::CertificateMonitor* monitor,
                                                    std::function<void()> on_turn) {
  credentials.Require([config = loaded.config](const rpc::PeerIdentity& self) {
    return CheckIdentity(config, self);
  });
  // Whatever else is wrong with them may pass: the robot is kept safe meanwhile.
  if (const absl::Status mine = credentials.Get().status(); absl::IsPermissionDenied(mine)) {
    return mine;
  }
  for (const std::string& warning : Warnings(loaded)) {
    LogWarning("configuration", {{"warning", warning}});
  }
  auto impl = std::make_unique<Impl>(loaded.config, clock, metrics);
  RIPS_RETURN_IF_ERROR(impl->Start(loaded, std::move(credentials), monitor, std::move(on_turn)));
  return std::unique_ptr<Agent>(new Agent(std::move(impl)));
}

absl::Status Agent::Ready() const { return impl_->Ready(); }
std::string Agent::Describe() const { return impl_->Describe(); }
absl::Status Agent::modes_problem() const { return impl_->modes_problem(); }
dds::InterfacesInUse Agent::interfaces() const { return impl_->interfaces(); }

absl::Status Agent::TryModes(const LoadedConfig& loaded, const Clock* clock) {
  return Join(loaded.config, clock).status();
}

}  // namespace rips::actuator
