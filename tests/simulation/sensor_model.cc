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
  bool streaming = false;
  bool has_setup = false;
  bool has_ack[2] = {false, false};
  bool wants_snapshot = false;
  uint64_t granted = 0;
  uint64_t used = 0;
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
  void Grant(uint64_t message_bytes, uint64_t) override {
    Send([=](SensorModel& sensor) {
      sensor.stream_->granted = std::max(sensor.stream_->granted, message_bytes);
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

void SensorModel::Start() {
  incarnation_ = absl::StrFormat("%016d", ++life_);
  outbox_.emplace(sensor::OutboxLimits{});
  for (size_t lane : {0, 1}) {
    acknowledged_[lane] = shifted_[lane] = delivered_[lane] = 0;
  }
  graph_ = ros2::RosGraph();
  (void)graph_.Apply(GraphNow(intruder_));
  graph_version_ = 1;
  TakeSnapshot();
  context_.trace.Add("sensor", absl::StrCat("starts as ", incarnation_));
  Later(context_.scheduler.Between(1, 300) * kMs, [this] { Connect(); });
  Tick();
}

void SensorModel::Crash() {
  context_.trace.Add("sensor", "crashes");
  Break(false);
  ++life_;
  outbox_.reset();
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
  const bool told = status.message() != "broken";
  if (told) {
    context_.trace.Add("sensor", absl::StrCat("stream closed: ", status.message()));
    server_.Call(stream->server_life,
                 [&](pipeline::Robot& robot) { robot.OnSensorGone(kHost, stream->link.get()); });
  }
  Later(context_.scheduler.Between(50, 1'500) * kMs, [this] { Connect(); });
}

void SensorModel::Connect() {
  if (stream_ != nullptr) return;
  if (!server_.up()) {
    return Later(context_.scheduler.Between(100, 800) * kMs, [this] { Connect(); });
  }
  outbox_->Rewind();
  stream_ = std::make_shared<Stream>(&context_.scheduler);
  stream_->server_life = server_.life();
  stream_->link = std::make_shared<ServerEnd>(this, stream_);
  context_.trace.Add("sensor", "connects");
  Send([hello = MakeHello(), link = stream_->link](pipeline::Robot& robot, const auto*) {
    robot.OnSensorHello(kHost, link, hello);
  });
}

pipeline::SensorHello SensorModel::MakeHello() {
  pipeline::SensorHello hello{.incarnation = incarnation_, .clock = Clock(), .store = store_};
  for (const sensor::Lane lane : {sensor::Lane::kControl, sensor::Lane::kMessages}) {
    const sensor::SequenceRange range = outbox_->Unacked(lane);
    hello.spooled.push_back({.incarnation = incarnation_,
                             .lane = ToServer(lane),
                             .first_sequence = range.first,
                             .last_sequence = range.last,
                             .acknowledged = acknowledged_[Index(lane)]});
  }
  return hello;
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
  store_ = setup.store;
  stream_->has_setup = true;
  stream_->wants_snapshot |= setup.want_snapshot;
  FinishResume();
}

void SensorModel::OnAcknowledge(const std::string& incarnation, pipeline::Lane lane,
                                uint64_t sequence, uint64_t commit) {
  if (incarnation != incarnation_) return;
  const bool control = lane == pipeline::Lane::kControl;
  const sensor::Lane own = control ? sensor::Lane::kControl : sensor::Lane::kMessages;
  const size_t index = Index(own);
  sequence -= std::min(sequence, shifted_[index]);
  store_.commit = std::max(store_.commit, commit);
  acknowledged_[index] = std::max(acknowledged_[index], sequence);
  const bool resuming = !std::exchange(stream_->has_ack[index], true);
  if (resuming && control && sequence < outbox_->acknowledged(own)) {
    stream_->wants_snapshot = true;  // the server has lost what it knew of us
  }
  const absl::Status taken = outbox_->Acknowledge(own, sequence);
  if (!taken.ok() && context_.fault == Fault::kNone) context_.checker.OnRefused(taken.message());
  FinishResume();
}

void SensorModel::FinishResume() {
  Stream& stream = *stream_;
  if (!stream.streaming) {
    if (!stream.has_setup || !stream.has_ack[0] || !stream.has_ack[1]) return;
    stream.streaming = true;
    context_.trace.Add("sensor", "streams");
  }
  const bool forgot =
      std::exchange(stream.wants_snapshot, false) && !outbox_->GraphStartsWithSnapshot();
  if (forgot && !outbox_->StartGraphWithSnapshot(now_ns())) TakeSnapshot();
}

// --- sending

void SensorModel::Tick() {
  const int64_t now = now_ns();
  outbox_->FlushMerged(now);
  if (stream_ != nullptr && now >= last_heartbeat_ns_ + 500 * kMs) {
    last_heartbeat_ns_ = now;
    Send([clock = Clock()](pipeline::Robot& robot, const pipeline::SensorLink* link) {
      robot.OnSensorHeartbeat(kHost, link, {.clock = clock});
    });
  }
  if (stream_ != nullptr && stream_->streaming) {
    SendBatch(sensor::Lane::kControl);
    if (stream_->granted > stream_->used) SendBatch(sensor::Lane::kMessages);
  }
  Later(kTickNs, [this] { Tick(); });
}

void SensorModel::SendBatch(sensor::Lane lane) {
  const size_t count = std::min<size_t>(outbox_->unsent(lane),
                                        static_cast<size_t>(context_.scheduler.Between(1, 8)));
  if (count == 0) return;
  const uint64_t first = outbox_->NextSequence(lane);
  pipeline::Batch batch{.incarnation = incarnation_, .lane = ToServer(lane), .bytes = 100};
  batch.first_sequence = NumberOf(lane, first);
  for (size_t i = 0; i < count; ++i) {
    batch.observations.push_back(lane == sensor::Lane::kControl
                                     ? ToServerObservation(outbox_->UnsentControl(i))
                                     : ToServerObservation(outbox_->UnsentMessage(i)));
    context_.checker.OnNumbered(KeyOf(incarnation_, batch.lane), batch.first_sequence + i,
                                ObservationId(batch.observations.back()));
  }
  outbox_->MarkSent(lane, count);
  stream_->used += lane == sensor::Lane::kMessages ? batch.bytes : 0;
  context_.trace.Add("sensor", absl::StrCat("sends ", lane == sensor::Lane::kControl ? "c" : "m",
                                            batch.first_sequence, " and ", count - 1, " more"));
  Send([this, lane, server_life = stream_->server_life,
        shared = std::make_shared<const pipeline::Batch>(std::move(batch))](
           pipeline::Robot& robot, const pipeline::SensorLink* link) {
    if (std::exchange(delivered_to_, server_life) != server_life) {
      delivered_[0] = delivered_[1] = 0;
    }
    uint64_t& delivered = delivered_[Index(lane)];
    if (shared->incarnation == incarnation_) {
      delivered = std::max(delivered, shared->first_sequence + shared->observations.size() - 1);
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

void SensorModel::TakeSnapshot() {
  outbox_->ReplaceGraph({{.to_version = graph_version_,
                          .settled = true,
                          .delta = ros2::RosGraph::Diff(ros2::RosGraph(), graph_)}},
                        now_ns());
  outbox_->ReleaseMessages();
}

void SensorModel::SeeProbe() {
  outbox_->AddControl({.boottime_ns = now_ns(),
                       .what = sensor::IdsAlert{.sid = ++observations_, .message = "probe"}});
}

void SensorModel::SeeMessage() {
  outbox_->AddMessage({.boottime_ns = now_ns(),
                       .source = SourceOf(intruder_ && context_.scheduler.Chance(3)),
                       .size_bytes = ++observations_,
                       .graph_version = graph_version_});
}

void SensorModel::SeeSignal() { outbox_->AddSignal("SIGUSR1", now_ns()); }

void SensorModel::IntruderComesOrGoes() {
  intruder_ = !intruder_;
  context_.trace.Add("robot", intruder_ ? "an intruder comes" : "the intruder goes");
  if (!up()) return;
  ros2::RosGraph next;
  (void)next.Apply(GraphNow(intruder_));
  outbox_->AddGraph({.from_version = graph_version_,
                     .to_version = graph_version_ + 1,
                     .settled = true,
                     .delta = ros2::RosGraph::Diff(graph_, next)},
                    now_ns());
  graph_ = next;
  ++graph_version_;
}

}  // namespace rips::simulation
