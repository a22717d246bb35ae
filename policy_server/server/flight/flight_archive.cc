#include "policy_server/server/flight/flight_archive.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/time/time.h"
#include "policy_server/server/flight/flight_codec.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::flight {

// On the robot's thread.
class FlightArchive::RobotRecorder final : public pipeline::FlightRecorder {
 public:
  RobotRecorder(FlightArchive* archive, std::string robot)
      : archive_(*archive), robot_(std::move(robot)) {}
  ~RobotRecorder() override {
    if (!alerts_.empty()) Save();
  }

  bool OnEvent(const pipeline::JudgedEvent& event) override {
    ring_.Add(event);
    return true;
  }
  bool OnLevel(const pipeline::LevelChange& level) override {
    ring_.Add(level);
    return true;
  }
  void Keep(const pipeline::GraveAlert& alert) override {
    gravest_ = std::max(gravest_, alert.severity);
    if (alerts_.size() >= kAlertsMax) {
      return archive_.files_->Lose(alert.id, "too many alerts came at once; see an earlier one's");
    }
    alerts_.push_back({.id = alert.id,
                       .rule = alert.rule,
                       .severity = std::string(engine::ToString(alert.severity)),
                       .text = Shortened(alert.text, recording::RecordedAlert::kTextBytesMax),
                       .time_unix_ns = alert.time_unix_ns});
    archive_.files_->Expect(alert.id);
  }
  bool wants_piece(Instant now) const override {
    return ring_.wants_piece(now) || (!alerts_.empty() && MaySave(now));
  }
  void BeginPiece(pipeline::RulesState state, Instant now) override {
    Refill(now);
    // Those of another bundle are saved before they go.
    const bool last_chance = bundle_id_ != state.bundle_id;
    if (!alerts_.empty() && (last_chance || MaySave(now))) {
      if (now.boottime_ns >= next_ns_) next_ns_ = now.boottime_ns + kPauseNs;
      saved_ = gravest_;
      Save();
    }
    // What was saved in a pause that is over makes nothing wait.
    if (now.boottime_ns >= next_ns_) saved_ = engine::Severity::kInfo;
    bundle_id_ = state.bundle_id;
    ring_.Begin(std::move(state), now);
  }

 private:
  bool MaySave(Instant now) const {
    const bool graver = gravest_ > saved_;
    const bool due = (now.boottime_ns >= next_ns_ && spent_bytes_ < kBurstBytes) ||
                     (graver && spent_bytes_ < 2 * kBurstBytes);
    return due && !*waits_ && archive_.has_room();
  }
  // What was saved is forgotten at the rate that a robot has.
  void Refill(Instant now) {
    const int64_t passed_ns = now.boottime_ns - refilled_ns_;
    const auto refill = static_cast<size_t>(passed_ns / kNanosPerMilli * kBytesPerMilli);
    spent_bytes_ -= std::min(spent_bytes_, refill);
    refilled_ns_ = now.boottime_ns;
  }
  void Save() {
    *waits_ = true;
    gravest_ = engine::Severity::kInfo;
    spent_bytes_ += ring_.bytes();
    archive_.Submit({.robot = robot_,
                     .flight = ring_.Take(),
                     .bytes = ring_.bytes(),
                     .alerts = std::exchange(alerts_, {}),
                     .waits = waits_});
  }

  FlightArchive& archive_;
  const std::string robot_;
  FlightRing ring_;
  std::string bundle_id_;
  // Since the last recording.
  std::vector<recording::RecordedAlert> alerts_;
  // Of those; and of what was saved in this pause.
  engine::Severity gravest_ = engine::Severity::kInfo;
  engine::Severity saved_ = engine::Severity::kInfo;
  int64_t next_ns_ = 0;
  size_t spent_bytes_ = 0;
  int64_t refilled_ns_ = 0;
  const std::shared_ptr<std::atomic<bool>> waits_ = std::make_shared<std::atomic<bool>>(false);
};

FlightArchive::FlightArchive(FlightFiles* files, ArchiveReports reports)
    : files_(files), reports_(std::move(reports)), thread_([this] { Run(); }) {}

FlightArchive::~FlightArchive() {
  jobs_.Close();
  thread_.join();
}

std::unique_ptr<pipeline::FlightRecorder> FlightArchive::NewRecorder(const std::string& robot) {
  return std::make_unique<RobotRecorder>(this, robot);
}

void FlightArchive::Submit(Job job) {
  pending_bytes_ += job.bytes;
  const size_t bytes = job.bytes;
  if (!jobs_.Push(std::move(job))) pending_bytes_ -= bytes;
}

void FlightArchive::Run() {
  while (std::optional<Job> job = jobs_.Pop(absl::InfiniteDuration())) {
    const absl::Status saved = Save(*job);
    pending_bytes_ -= job->bytes;
    *job->waits = false;
    if (saved.ok()) {
      failing_ = false;
      if (reports_.saved) reports_.saved();
      continue;
    }
    LogWarning("a recording could not be saved", {{"robot", job->robot}, {"why", saved.message()}});
    for (const recording::RecordedAlert& each : job->alerts) files_->Lose(each.id, saved.message());
    if (reports_.failed) reports_.failed();
    if (!std::exchange(failing_, true) && reports_.problem) reports_.problem(saved);
  }
}

absl::Status FlightArchive::Save(const Job& job) {
  const recording::RecordedOrigin origin = OriginOf(job.robot, job.flight, job.alerts);
  RIPS_ASSIGN_OR_RETURN(const std::string bytes, EncodeFlight(origin, job.flight));
  return files_->Save(origin, bytes);
}

}  // namespace rips::flight
