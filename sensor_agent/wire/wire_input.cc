#include "sensor_agent/wire/wire_input.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/log.h"

namespace rips::wire {

namespace {

// A tap reports every 200 ms; one that is silent for so long is as good as none.
constexpr int64_t kSilenceNs = 2 * kNanosPerSecond;

void CountSince(const Counter& counter, uint64_t now, uint64_t& before) {
  if (now > before) counter.Increment(static_cast<double>(now - before));
  before = now;
}

}  // namespace

WireInput::WireInput(const WireInputOptions& options, Metrics* metrics)
    : packets_(
          metrics->AddCounter("rips_sensor_wire_packets_total", "RTPS datagrams that the tap saw")),
      malformed_(metrics->AddCounter("rips_sensor_wire_malformed_total",
                                     "Datagrams that broke off at a senseless submessage")),
      cut_(metrics->AddCounter("rips_sensor_wire_cut_total",
                               "Datagrams with submessages beyond what is captured")),
      dropped_(metrics->AddCounter(
          "rips_sensor_wire_dropped_total",
          "Datagrams, reports and findings of the tap left out because of a limit")),
      connected_(metrics->AddGauge("rips_sensor_wire_connected", "A tap reports")),
      standing_(metrics->AddGauge("rips_sensor_wire_findings", "Findings of the tap that stand")),
      watch_(WatchOptions{.domain = options.domain, .secured = options.secured}),
      socket_path_(options.socket) {}

absl::StatusOr<std::unique_ptr<WireInput>> WireInput::Create(const WireInputOptions& options,
                                                             std::function<void()> wake,
                                                             Metrics* metrics) {
  std::unique_ptr<WireInput> input(new WireInput(options, metrics));
  RIPS_ASSIGN_OR_RETURN(
      input->socket_,
      WireSocket::Listen({.path = options.socket, .domain = options.domain}, std::move(wake)));
  return input;
}

void WireInput::OnDiscovered(const sensor::Discovered& discovered, int64_t now_ns) {
  if (const auto* endpoint = std::get_if<sensor::EndpointFact>(&discovered.what)) {
    if (!discovered.alive) {
      watch_.WriterGone(endpoint->guid, now_ns);  // which a reader is not
    } else if (endpoint->writer) {
      watch_.WriterSeen(endpoint->guid, ros2::DemangleTopic(endpoint->topic).name);
    }
    return;
  }
  const ros2::Guid& participant = std::get<ros2::Participant>(discovered.what).guid;
  if (discovered.alive) {
    watch_.ParticipantSeen(participant, ParseLocators(discovered.addresses));
  } else {
    watch_.ParticipantGone(participant, now_ns);
  }
}

bool WireInput::visible(int64_t now_ns) const {
  return socket_->connected() && last_report_ns_ != 0 && now_ns - last_report_ns_ < kSilenceNs;
}

std::vector<std::string> WireInput::Blind(int64_t now_ns) {
  std::vector<std::string> reasons;
  if (watch_.MissesSome()) {
    reasons.push_back("wire tap: a writer sends others what does not come to the sensor");
  }
  if (visible(now_ns)) {
    away_since_ns_ = 0;
    if (watch_.blind()) {
      reasons.push_back(
          "wire tap: discovery shows more than its limits; unknown writers are not told");
    }
    return reasons;
  }
  if (away_since_ns_ == 0) away_since_ns_ = now_ns;
  if (now_ns - away_since_ns_ >= kAwayNs) {
    reasons.push_back(absl::StrCat("wire tap: no rips-wire reports at `", socket_path_, "`"));
  }
  return reasons;
}

void WireInput::TakeReport(const TapReport& report, int64_t now_ns) {
  last_report_ns_ = now_ns;
  CountSince(packets_, report.counters.packets, tap_counted_.packets);
  CountSince(malformed_, report.counters.malformed, tap_counted_.malformed);
  CountSince(cut_, report.counters.cut, tap_counted_.cut);
  CountSince(dropped_, report.counters.kernel_drops, tap_counted_.kernel_drops);
  CountSince(dropped_, report.counters.table_drops, tap_counted_.table_drops);
  watch_.Take(report, now_ns);
}

void WireInput::CountLimits() {
  const WatchCounters& watch = watch_.counters();
  CountSince(dropped_, watch.dropped + watch.findings_dropped + socket_->dropped(),
             dropped_counted_);
  if (watch_.blind() == blind_logged_) return;
  blind_logged_ = watch_.blind();
  if (blind_logged_) {
    LogError("graph exceeds the tap's limits; unknown writers are not reported");
  } else {
    LogInfo("graph is within the tap's limits; unknown writers are reported");
  }
}

std::vector<sensor::ControlObservation> WireInput::Poll(const sensor::GraphBuilder& graph,
                                                        int64_t now_ns) {
  for (const Received& each : socket_->Take()) {
    if (each.connected) {
      watch_.TapChanged();
      tap_changed_ns_ = now_ns;
      tap_counted_ = {};
      last_report_ns_ = 0;
    } else {
      TakeReport(each.report, now_ns);
    }
  }
  connected_.Set(visible(now_ns) ? 1 : 0);
  std::vector<sensor::ControlObservation> observations;
  for (sensor::Finding& finding : watch_.Poll(graph.settled(), now_ns)) {
    SetNode(graph, finding);
    NoteCoverage(finding);
    Log(finding.over ? LogLevel::kInfo : LogLevel::kWarning,
        finding.over ? "finding over" : "finding",
        {{"kind", finding.kind},
         {"guid", ToString(finding.guid)},
         {"node", finding.node},
         {"topic", finding.topic},
         {"detail", finding.detail}});
    observations.push_back({.boottime_ns = now_ns, .what = std::move(finding)});
  }
  standing_.Set(static_cast<double>(watch_.standing().size()));
  CountLimits();
  return observations;
}

void WireInput::NoteCoverage(const sensor::Finding& finding) {
  if (finding.kind != kDirectedData && finding.kind != kTwoContents) return;
  coverage_.push_back({.writer = finding.guid, .not_visible = NotVisible(finding.guid)});
}

std::string WireInput::NotVisible(const ros2::Guid& writer) const {
  return watch_.Misses(writer) ? "it sends others what does not come to us" : "";
}

std::vector<sensor::MessageSeen> WireInput::TakeUnseen(const sensor::GraphBuilder& graph,
                                                       int64_t now_ns) {
  std::vector<sensor::MessageSeen> unseen;
  for (const SecondContent& each : watch_.TakeSecondContents()) {
    std::optional<ros2::Endpoint> writer = graph.Find(each.writer);
    if (!writer.has_value()) continue;
    writer->pending = false;
    unseen.push_back({.boottime_ns = now_ns,
                      .source = std::make_shared<const sensor::MessageSource>(sensor::MessageSource{
                          .topic = writer->name, .type = writer->type, .writer = *writer}),
                      .writer_sequence = each.number,
                      .size_bytes = std::max<uint32_t>(each.size, 1),
                      .graph_version = graph.VersionShowing(each.writer).value_or(0)});
  }
  return unseen;
}

std::vector<sensor::ControlObservation> WireInput::Standing(int64_t now_ns) const {
  std::vector<sensor::ControlObservation> observations;
  for (const auto& [key, finding] : watch_.standing()) {
    observations.push_back({.boottime_ns = now_ns, .what = finding});
    auto& named = std::get<sensor::Finding>(observations.back().what);
    const auto node = nodes_.find({named.kind, named.guid});
    if (node != nodes_.end()) named.node = node->second;
  }
  return observations;
}

void WireInput::SetNode(const sensor::GraphBuilder& graph, sensor::Finding& finding) {
  std::pair<std::string, ros2::Guid> key(finding.kind, finding.guid);
  if (finding.over) {
    if (auto node = nodes_.extract(key)) finding.node = std::move(node.mapped());
    return;
  }
  if (const auto endpoint = graph.Find(finding.guid)) finding.node = endpoint->node;
  nodes_[std::move(key)] = finding.node;
}

bool WireInput::ToldAll(int64_t now_ns) const {
  return !watch_.full() && (tap_changed_ns_ == 0 || now_ns >= tap_changed_ns_ + kTapSettleNs);
}

}  // namespace rips::wire
