#include "tests/simulation/sensor_model.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "tests/simulation/observations.h"

namespace rips::simulation {
namespace {

// Of any batch, in the server's credit.
constexpr uint64_t kBatchBytes = 100;

size_t Index(sensor::Lane lane) { return lane == sensor::Lane::kControl ? 0 : 1; }
pipeline::Lane ToServer(sensor::Lane lane) {
  return lane == sensor::Lane::kControl ? pipeline::Lane::kControl : pipeline::Lane::kMessages;
}
store::LaneKey KeyOf(const std::string& incarnation, pipeline::Lane lane) {
  const bool control = lane == pipeline::Lane::kControl;
  return {.host = kHost,
          .incarnation = absl::BytesToHexString(incarnation),
          .lane = control ? store::LaneKey::Lane::kControl : store::LaneKey::Lane::kMessages};
}

}  // namespace

struct SensorModel::Stream {
  explicit Stream(Scheduler* scheduler) : up(scheduler), down(scheduler) {}
  Line up;
  Line down;
  uint64_t server_life = 0;
  std::shared_ptr<pipeline::SensorLink> link;
};

// What the robot holds of a stream. Keeps no stream alive that has ended.
class SensorModel::ServerEnd final : public pipeline::SensorLink {
 public:
  ServerEnd(SensorModel* sensor, const std::shared_ptr<Stream>& stream)
      : sensor_(*sensor), stream_(stream) {}

  void Setup(const pipeline::SensorSetup& setup) override {
    if (!std::exchange(accepted_, true)) {
      sensor_.context_.checker.OnSensorAccepted(sensor_.context_.scheduler.now_ns());
    }
    Send([setup](SensorModel& sensor) { sensor.OnSetup(setup); });
  }
  void Acknowledge(const std::string& incarnation, pipeline::Lane lane, uint64_t sequence,
                   uint64_t commit) override {
    sensor_.context_.checker.OnAcknowledged(KeyOf(incarnation, lane), sequence);
    Send([=](SensorModel& sensor) { sensor.OnAcknowledge(incarnation, lane, sequence, commit); });
  }
  void Grant(uint64_t message_bytes, uint64_t payload_bytes) override {
    Send([=](SensorModel& sensor) {
      sensor.On(
          sensor::CreditReceived{.message_bytes = message_bytes, .payload_bytes = payload_bytes});
    });
  }
  void Heartbeat(int64_t) override {}
  std::string SetInterest(const engine::InterestPlan&, const engine::PayloadLimits&,
                          const ros2::TopicNames&) override {
    const std::string id = "interest";  // of the one policy there is
    Send([id](SensorModel& sensor) {
      sensor.Send([id](pipeline::Robot& robot, const pipeline::SensorLink* link) {
        robot.OnInterestAnswer(kHost, link, {.id = id});
      });
    });
    return id;
  }
  void Close(const absl::Status& status) override {
    const auto stream = stream_.lock();
    if (stream == nullptr) return;
    if (absl::IsInvalidArgument(status)) sensor_.context_.checker.OnRefused(status.message());
    stream->down.Send(
        [this_sensor = &sensor_, stream, status] { this_sensor->Disconnected(stream, status); });
  }

 private:
  void Send(std::function<void(SensorModel&)> deliver) {
    const auto stream = stream_.lock();
    if (stream == nullptr) return;
    stream->down.Send([this_sensor = &sensor_, weak = stream_, deliver = std::move(deliver)] {
      if (this_sensor->stream_ != nullptr && weak.lock() == this_sensor->stream_) {
        deliver(*this_sensor);
      }
    });
  }

  SensorModel& sensor_;
  std::weak_ptr<Stream> stream_;
  bool accepted_ = false;
};

// --- the process and its streams

std::string SensorModel::NewIncarnation() { return absl::StrFormat("%016d", ++incarnations_); }

void SensorModel::Start() {
  ++life_;
  wake_ns_ = 0;
  core_.emplace(sensor::UplinkCoreOptions{}, NewIncarnation(), NewIncarnation());
  store_point_ = {};
  for (size_t lane : {0, 1}) shifted_[lane] = delivered_[lane] = 0;
  aside_.clear();
  graph_ = ros2::RosGraph();
  (void)graph_.Apply(GraphNow(intruder_));
  graph_version_ = 1;
  context_.trace.Add("sensor", absl::StrCat("starts as ", core_->incarnation()));
  On(sensor::Observations{.graph = {WholeGraph()}, .settled = true});
  Later(context_.scheduler.Between(1, 300) * kMs, [this] { Connect(); });
  Tick();
}

void SensorModel::Crash() {
  context_.trace.Add("sensor", "crashes");
  Break(false);
  ++life_;
  core_.reset();
}

void SensorModel::Break(bool half_open) {
  if (stream_ == nullptr) return;
  context_.trace.Add("sensor", half_open ? "stream breaks, half open" : "stream breaks");
  const std::shared_ptr<Stream> stream = stream_;
  stream->up.Cut();
  stream->down.Cut();
  Disconnected(stream, absl::UnavailableError("broken"));
  if (half_open) return;
  context_.scheduler.After(context_.scheduler.Between(0, 200) * kMs, [this, stream] {
    server_.Call(stream->server_life,
                 [&](pipeline::Robot& robot) { robot.OnSensorGone(kHost, stream->link.get()); });
  });
}

void SensorModel::Later(int64_t delay_ns, Task task) {
  context_.scheduler.After(delay_ns, [this, life = life_, task = std::move(task)] {
    if (life == life_) task();
  });
}

void SensorModel::Disconnected(const std::shared_ptr<Stream>& stream, const absl::Status& status) {
  if (stream_ != stream) return;
  stream_ = nullptr;
  if (status.message() != "broken") {
    context_.trace.Add("sensor", absl::StrCat("stream closed: ", status.message()));
    server_.Call(stream->server_life,
                 [&](pipeline::Robot& robot) { robot.OnSensorGone(kHost, stream->link.get()); });
  }
  On(sensor::StreamEnded{.status = status});
  Later(context_.scheduler.Between(50, 1'500) * kMs, [this] { Connect(); });
}

void SensorModel::Connect() {
  if (stream_ != nullptr) return;
  if (!server_.up()) {
    return Later(context_.scheduler.Between(100, 800) * kMs, [this] { Connect(); });
  }
  stream_ = std::make_shared<Stream>(&context_.scheduler);
  stream_->server_life = server_.life();
  stream_->link = std::make_shared<ServerEnd>(this, stream_);
  context_.trace.Add("sensor", "connects");
  On(sensor::StreamBegan{.incarnation = NewIncarnation()});
}

void SensorModel::Send(std::function<void(pipeline::Robot&, const pipeline::SensorLink*)> call) {
  if (stream_ == nullptr) return;
  stream_->up.Send(
      [this, life = stream_->server_life, link = stream_->link, call = std::move(call)] {
        server_.Call(life, [&](pipeline::Robot& robot) { call(robot, link.get()); });
      });
}

// --- what the server says

void SensorModel::OnSetup(const pipeline::SensorSetup& setup) {
  store_point_ = setup.store;
  const auto most = static_cast<size_t>(context_.scheduler.Between(1, 8));
  On(sensor::ConfigReceived{.policy = {.observations = most},
                            .want_snapshot = setup.want_snapshot});
}

void SensorModel::OnAcknowledge(const std::string& incarnation, pipeline::Lane lane,
                                uint64_t sequence, uint64_t commit) {
  const bool control = lane == pipeline::Lane::kControl;
  const sensor::Lane own = control ? sensor::Lane::kControl : sensor::Lane::kMessages;
  if (incarnation == core_->incarnation()) sequence -= std::min(sequence, shifted_[Index(own)]);
  store_point_.commit = std::max(store_point_.commit, commit);
  On(sensor::AckReceived{.stream = {.incarnation = incarnation, .lane = own},
                         .sequence = sequence});
}

// --- what the core wants done

// One function for each action; those with a result give it.
struct SensorModel::Performer {
  using Result = std::optional<sensor::UplinkInput>;

  Result operator()(const sensor::SendHello& action) {
    pipeline::SensorHello hello{.incarnation = action.incarnation,
                                .clock = model.Clock(),
                                .not_visible = action.not_visible,
                                .blind = action.blind,
                                .store = model.store_point_};
    for (const sensor::AnnouncedRange& each : action.ranges) {
      hello.spooled.push_back({.incarnation = each.range.stream.incarnation,
                               .lane = ToServer(each.range.stream.lane),
                               .first_sequence = each.range.first_sequence,
                               .last_sequence = each.range.last_sequence,
                               .acknowledged = each.acknowledged.value_or(0)});
    }
    model.Send([hello, link = model.stream_->link](pipeline::Robot& robot, const auto*) {
      robot.OnSensorHello(kHost, link, hello);
    });
    return std::nullopt;
  }
  Result operator()(const sensor::SendHeartbeat&) {
    model.Send([clock = model.Clock()](pipeline::Robot& robot, const pipeline::SensorLink* link) {
      robot.OnSensorHeartbeat(kHost, link, {.clock = clock});
    });
    return std::nullopt;
  }
  Result operator()(const sensor::SendBatch& action) {
    if (model.context_.scheduler.Chance(2)) {
      return sensor::BatchSent{.status = sensor::SendStatus::kLineFull};
    }
    const sensor::Outbox& outbox = model.core_->outbox();
    pipeline::Batch batch{
        .incarnation = model.core_->incarnation(),
        .lane = ToServer(action.lane),
        .first_sequence = model.NumberOf(action.lane, outbox.NextSequence(action.lane)),
        .bytes = kBatchBytes};
    for (size_t i = 0; i < action.count; ++i) {
      batch.observations.push_back(action.lane == sensor::Lane::kControl
                                       ? ToServerObservation(outbox.UnsentControl(i))
                                       : ToServerObservation(outbox.UnsentMessage(i)));
    }
    model.SendBatch(std::move(batch));
    return sensor::BatchSent{.count = action.count, .bytes = kBatchBytes};
  }
  Result operator()(const sensor::EncodeForBacklog& action) {
    sensor::Encoded encoded{.stream = action.stream,
                            .first_sequence = action.first_sequence,
                            .oldest_ns = model.now_ns(),
                            .bytes = absl::StrFormat("%d", ++model.encoded_)};
    std::vector<pipeline::Observation>& kept = model.aside_[encoded.bytes];
    std::visit(
        [&](const auto& observations) {
          for (const auto& each : observations) kept.push_back(ToServerObservation(each));
        },
        action.observations);
    encoded.count = static_cast<uint32_t>(kept.size());
    return encoded;
  }
  Result operator()(const sensor::OpenBacklog& action) {
    model.opened_ = action.batch;
    return sensor::BacklogOpened{.bytes_max = kBatchBytes};
  }
  Result operator()(const sensor::SendBacklog&) {
    const sensor::BacklogBatch& opened = model.opened_;
    model.SendBatch({.incarnation = opened.stream.incarnation,
                     .lane = ToServer(opened.stream.lane),
                     .first_sequence = opened.first_sequence,
                     .observations = model.aside_.at(*opened.bytes),
                     .bytes = kBatchBytes});
    return sensor::BacklogSent{.count = opened.count, .bytes = kBatchBytes};
  }
  Result operator()(const sensor::StreamResumed&) {
    model.context_.trace.Add("sensor", "streams");
    return std::nullopt;
  }
  Result operator()(const sensor::CloseStream& action) {
    if (model.context_.fault == Fault::kNone) model.context_.checker.OnRefused(action.why);
    model.Break(false);
    return std::nullopt;
  }
  Result operator()(const sensor::WantGraph&) {
    return sensor::WholeGraph{.snapshot = {model.WholeGraph()}};
  }
  // It has no findings that stand, no disk and no payloads.
  template <typename Other>
  Result operator()(const Other&) {
    return std::nullopt;
  }

  SensorModel& model;
};

void SensorModel::On(sensor::UplinkInput input) {
  Performer performer{*this};
  sensor::UplinkActions actions = core_->On(std::move(input), Clock());
  std::vector<sensor::UplinkInput> results;
  for (size_t done = 0;; ++done) {
    for (const sensor::UplinkAction& each : actions.list) {
      if (auto result = std::visit(performer, each)) results.push_back(*std::move(result));
    }
    if (done == results.size()) break;
    actions = core_->On(std::move(results[done]), Clock());
  }
  wake_ns_ = std::min(wake_ns_, actions.wake_ns);
}

void SensorModel::Tick() {
  if (wake_ns_ <= now_ns()) {
    wake_ns_ = sensor::SendSession::kNever;
    On(sensor::Turn{});
  }
  Later(kTickNs, [this] { Tick(); });
}

void SensorModel::SendBatch(pipeline::Batch batch) {
  const bool control = batch.lane == pipeline::Lane::kControl;
  for (size_t i = 0; i < batch.observations.size(); ++i) {
    context_.checker.OnNumbered(KeyOf(batch.incarnation, batch.lane), batch.first_sequence + i,
                                ObservationId(batch.observations[i]));
  }
  context_.trace.Add("sensor", absl::StrCat("sends ", control ? "c" : "m", batch.first_sequence,
                                            " and ", batch.observations.size() - 1, " more"));
  Send([this, lane = control ? 0 : 1, server_life = stream_->server_life,
        shared = std::make_shared<const pipeline::Batch>(std::move(batch))](
           pipeline::Robot& robot, const pipeline::SensorLink* link) {
    if (std::exchange(delivered_to_, server_life) != server_life) {
      delivered_[0] = delivered_[1] = 0;
    }
    if (core_.has_value() && shared->incarnation == core_->incarnation()) {
      delivered_[lane] =
          std::max(delivered_[lane], shared->first_sequence + shared->observations.size() - 1);
    }
    robot.OnBatch(kHost, link, shared);
  });
}

uint64_t SensorModel::NumberOf(sensor::Lane lane, uint64_t first) {
  const size_t index = Index(lane);
  if (context_.fault != Fault::kJudgedTwice) return first;
  // What this server has taken already goes out under the next free number.
  if (delivered_to_ == stream_->server_life && first + shifted_[index] <= delivered_[index]) {
    shifted_[index] = delivered_[index] + 1 - first;
  }
  return first + shifted_[index];
}

// --- what happens on the robot

sensor::GraphChange SensorModel::WholeGraph() const {
  return {.to_version = graph_version_,
          .settled = true,
          .delta = ros2::RosGraph::Diff(ros2::RosGraph(), graph_)};
}

void SensorModel::SeeProbe() {
  const sensor::IdsAlert alert{.sid = ++observations_, .message = "probe"};
  On(sensor::Observations{.ids_alerts = {{.boottime_ns = now_ns(), .what = alert}}});
}

void SensorModel::SeeMessage() {
  On(sensor::Observations{
      .messages = {{.boottime_ns = now_ns(),
                    .source = SourceOf(intruder_ && context_.scheduler.Chance(3)),
                    .size_bytes = ++observations_,
                    .graph_version = graph_version_}}});
}

void SensorModel::SeeSignal() { On(sensor::Observations{.signals = {"SIGUSR1"}}); }

void SensorModel::IntruderComesOrGoes() {
  intruder_ = !intruder_;
  context_.trace.Add("robot", intruder_ ? "an intruder comes" : "the intruder goes");
  if (!up()) return;
  ros2::RosGraph next;
  (void)next.Apply(GraphNow(intruder_));
  On(sensor::Observations{.graph = {{.from_version = graph_version_,
                                     .to_version = graph_version_ + 1,
                                     .settled = true,
                                     .delta = ros2::RosGraph::Diff(graph_, next)}}});
  graph_ = next;
  ++graph_version_;
}

}  // namespace rips::simulation
