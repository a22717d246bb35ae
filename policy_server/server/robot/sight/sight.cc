#include "policy_server/server/robot/sight/sight.h"

#include <algorithm>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/model/dds_problem.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// Of one sensor's reasons, so that a hostile one cannot fill the status.
constexpr size_t kReasonsShown = 16;
bool HasMoved(const SensorHost& host) {
  return std::any_of(
      host.state.blind.begin(), host.state.blind.end(),
      [](const std::string& reason) { return absl::StartsWith(reason, model::kDdsBeginsAgain); });
}

// Between two snapshots that are asked for because the graph is truncated.
constexpr int64_t kRecoveryNs = 60 * kNanosPerSecond;

}  // namespace

void Sight::CountLeftOut(uint64_t left_out, bool began) {
  if (std::exchange(left_out_counted_, left_out) == left_out) return;
  context_.Do(action::CountLeftOut{.left_out = left_out, .began = began});
}

void Sight::ExamineGraph() {
  const SensorHost* primary = sensors_.primary();
  // Without a settled graph there is another evidence problem already, and nothing to examine.
  if (primary == nullptr || !primary->session || !primary->settled) {
    health_ = {};
    examined_ = {};
    // Of a sensor that is away, what was left out last stands.
    return CountLeftOut(left_out_counted_.value_or(0), false);
  }
  auto found_from =
      std::make_tuple(graph_.revision(), own_agents_.participants(), own_agents_.parts(),
                      primary->session->domain, HasMoved(*primary));
  if (found_from == examined_) return;
  examined_ = std::move(found_from);
  const auto& [revision, participants, parts, domain, moved] = examined_;
  health_ = pipeline::ExamineGraph(graph_.get(), {.sensor = primary->name,
                                                  .domain = domain,
                                                  .own_participants = participants,
                                                  .parts = parts,
                                                  .moved = moved});
  const ros2::Truncation truncation = graph_->truncation();
  CountLeftOut(truncation.left_out, truncation_alarm_.Set(truncation, context_.now_ns()));
}

void Sight::Update() {
  ExamineGraph();
  std::vector<std::string> reasons = health_.problems;
  for (const auto& [name, host] : sensors_.hosts()) {
    if (!host.session) continue;
    const std::vector<std::string>& blind = host.state.blind;
    for (size_t i = 0; i < std::min(blind.size(), kReasonsShown); ++i) {
      reasons.push_back(absl::StrCat("sensor ", name, ": ", ros2::Printable(blind[i])));
    }
    if (blind.size() > kReasonsShown) {
      reasons.push_back(
          absl::StrCat("sensor ", name, ": ", blind.size() - kReasonsShown, " more inputs"));
    }
  }
  blind_alarm_.Set(reasons, context_.now_ns());
  blind_ = std::move(reasons);
  // Has an alert of its own, at once.
  if (!health_.truncated.empty()) blind_.push_back(health_.truncated);
  if (std::exchange(blind_counted_, blind_.size()) == blind_.size()) return;
  context_.Do(action::CountBlind{.reasons = blind_.size()});
}

void Sight::OnState(const SensorHost& host) {
  coverage_alarm_.SetKinds(host.name, host.state.not_visible);
  Update();
}

void Sight::OnMessage(const MessageSeen& message) {
  // Without any payload it was not asked for, or shed: then it was not cut.
  const size_t bytes_max = context_.watch.PayloadBytes(message.topic);
  const size_t bytes = std::min(message.payload.size(), bytes_max);
  const bool cut = message.truncated || bytes < message.payload.size();
  if (!cut || bytes == 0) return;
  context_.Count(Counter::kPayloadsCut);
  cut_payloads_.Add(message.topic, static_cast<uint32_t>(bytes), message.size_bytes,
                    context_.now_ns());
}

void Sight::Report(bool parts_verified) {
  ReportCoverage();
  ReportTruncated();
  RecoverTruncated();
  ReportBlind(parts_verified);
}

void Sight::ReportTruncated() {
  const TruncationAlarm::Due due = truncation_alarm_.Pop(context_.now_ns());
  if (due.began) {
    alerts_.Raise(
        engine::Severity::kCritical,
        absl::StrCat("graph truncated: the graph of sensor ", context_.config.primary_sensor,
                     " hit a limit (up to ", due.left_out, " left out); ",
                     LargestParticipant(graph_.get()), "; rules lower no level of ",
                     context_.config.id, " meanwhile, and what they ask of the rest is unscanned"));
  }
  for (const ros2::Truncation::Crowd& crowd : due.crowds) {
    alerts_.Raise(engine::Severity::kHigh,
                  absl::StrCat(DescribeParticipant(graph_.get(), crowd.participant), " holds ",
                               crowd.endpoints, " endpoints of the graph; ", crowd.left_out,
                               " more participants, nodes or endpoints of it are left out"));
  }
  if (due.over) {
    alerts_.Raise(engine::Severity::kInfo,
                  absl::StrCat("the graph of sensor ", context_.config.primary_sensor,
                               " is whole again; rules have judged it"));
  }
}

// What was left out here stays so; when there is room again, the sensor sends the graph anew.
void Sight::RecoverTruncated() {
  if (health_.truncated.empty() || context_.now_ns() < next_recovery_ns_) return;
  // What the sensor left out, it asks discovery for itself.
  if (graph_->dropped() == 0 || !graph_->HasRoom()) return;
  next_recovery_ns_ = context_.now_ns() + kRecoveryNs;
  sensors_.RefuseGraph(
      *sensors_.primary(),
      absl::AbortedError("the graph hit a limit and there is room again: send it anew"));
}

void Sight::ReportBlind(bool parts_verified) {
  const std::vector<std::string> due = blind_alarm_.Due(context_.now_ns());
  if (!due.empty()) {
    // A robot whose ROS stack is off shows no node either. If an actuator reads the modes of its
    // parts all the same, the robot runs and the sensor looks elsewhere.
    const bool may_be_off = health_.empty && blind_.size() == 1 && !parts_verified;
    alerts_.Raise(may_be_off ? engine::Severity::kMedium : engine::Severity::kHigh,
                  absl::StrCat("blind: ", absl::StrJoin(due, "; "), "; rules lower no level of ",
                               context_.config.id, " meanwhile"));
  }
  // A sensor that is away says nothing, not that it sees.
  const SensorHost* primary = sensors_.primary();
  const bool all_say =
      primary != nullptr && primary->settled &&
      std::all_of(sensors_.hosts().begin(), sensors_.hosts().end(),
                  [](const auto& sensor) { return sensor.second.session.has_value(); });
  if (all_say && blind_.empty() && blind_alarm_.Over()) {
    alerts_.Raise(engine::Severity::kInfo, absl::StrCat(context_.config.id, " is seen again"));
  }
}

void Sight::ReportCoverage() {
  std::vector<ros2::Guid> own = own_agents_.participants();
  if (counted_revision_ != graph_.revision() || counted_without_ != own) {
    counted_revision_ = graph_.revision();
    counted_without_ = std::move(own);
    const EndpointCounts counts = CountEndpoints(graph_.get(), counted_without_);
    coverage_alarm_.SetNotVisible(counts.not_visible);
    context_.Do(action::CountEndpoints{counts});
  }
  for (const auto& [name, host] : sensors_.hosts()) {
    if (!host.session) continue;
    const std::optional<int64_t> skew_ns = host.session->skew.estimate_ns();
    if (skew_ns) context_.Do(action::ShowClockSkew{.host = name, .skew_ns = *skew_ns});
  }
  if (const auto fallen = coverage_alarm_.Due(context_.now_ns())) {
    alerts_.Raise(engine::Severity::kMedium, absl::StrCat("less is seen: ", *fallen));
  }
}

std::vector<CutPayloads::Topic> Sight::CutTopics() const {
  return cut_payloads_.Recent(context_.now_ns());
}

std::vector<SensorInterest> Sight::Interests() const {
  std::vector<SensorInterest> out;
  const SensorHost* primary = sensors_.primary();
  if (primary == nullptr) return out;
  SensorInterest& one = out.emplace_back(SensorInterest{.host = primary->name});
  if (!primary->session) return out;
  const SensorSession& session = *primary->session;
  one.connected = true;
  one.in_use = session.interest_in_use == session.interest_wanted;
  if (!one.in_use) one.problem = session.interest_problem;
  return out;
}

std::vector<SensorCoverage> Sight::Coverage() const {
  std::vector<SensorCoverage> out;
  for (const auto& [name, host] : sensors_.hosts()) {
    SensorCoverage& one =
        out.emplace_back(SensorCoverage{.host = name,
                                        .primary = name == context_.config.primary_sensor,
                                        .connected = host.session.has_value(),
                                        .state = host.state,
                                        .lost = host.losses.Total(context_.now_ns())});
    if (!host.session) continue;
    // A sensor that reports no graph has nothing to settle.
    one.settled = !one.primary || host.settled;
    one.clock_skew_ns = host.session->skew.estimate_ns();
  }
  return out;
}

}  // namespace rips::pipeline
