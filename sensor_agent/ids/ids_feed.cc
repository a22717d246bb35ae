#include "sensor_agent/ids/ids_feed.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::sensor {

namespace {

constexpr size_t kOffsetsBytesMax = size_t{1} << 20;
// On a busy log it is looked at this often instead of at every line.
constexpr int kBusyMs = 5;
constexpr int kUnderwayMs = 50;
// Not everything that happens to a file shows as an event.
constexpr int kIdleMs = 1'000;
constexpr int64_t kAcknowledgedSaveNs = kNanosPerSecond;
// Positions alone: only so that an old file may be removed without being missed.
constexpr int64_t kPositionSaveNs = 30 * kNanosPerSecond;
// A log that is renamed is away for a moment.
constexpr int64_t kNotOpenNs = 10 * kNanosPerSecond;
constexpr int64_t kStopNs = kNanosPerSecond / 2;

// Estimated memory.
size_t CostOf(const IdsAlert& alert) {
  return sizeof(alert) + alert.message.size() + alert.line.size() + alert.src.size() +
         alert.dst.size();
}

}  // namespace

IdsFeed::Log::Log(IdsLog log, std::optional<LogPosition> from, LogTailLimits limits,
                  Metrics* metrics)
    : what(std::move(log)), tail(what.path, from, limits) {
  const MetricLabels labels = {{"log", what.path}};
  alerts = metrics->AddCounter("rips_sensor_ids_alerts_total", "Alerts read from an IDS", labels);
  not_understood = metrics->AddCounter("rips_sensor_ids_not_understood_total",
                                       "Lines of an IDS log that make no sense", labels);
  too_long = metrics->AddCounter("rips_sensor_ids_too_long_total",
                                 "Lines of an IDS log longer than the limit", labels);
  gaps = metrics->AddCounter("rips_sensor_ids_gaps_total",
                             "Times that part of an IDS log may have been lost before it was read",
                             labels);
  truncated = metrics->AddCounter("rips_sensor_ids_truncated_total",
                                  "Times that an IDS log was truncated, read or not", labels);
  open = metrics->AddGauge("rips_sensor_ids_open", "1 while an IDS log is there and is followed",
                           labels);
}

IdsFeed::IdsFeed(IdsFeedOptions options, IdsSink sink, const Clock* clock, Metrics* metrics)
    : options_(std::move(options)),
      sink_(std::move(sink)),
      clock_(clock),
      dropped_(metrics->AddCounter("rips_sensor_ids_dropped_total",
                                   "Alerts read and not kept: too many were waiting")),
      unsaved_(metrics->AddGauge("rips_sensor_ids_unsaved",
                                 "1 while positions in IDS logs cannot be saved")),
      stop_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  // If that fails, so does saving, which says so.
  std::error_code ignored;
  std::filesystem::create_directories(std::filesystem::path(options_.offsets_file).parent_path(),
                                      ignored);
  const LogOffsets before = LoadOffsets();
  for (const IdsLog& each : options_.logs) {
    const auto it = before.logs.find(each.path);
    std::optional<LogPosition> from;
    if (it != before.logs.end()) from = it->second;
    logs_.push_back(std::make_unique<Log>(each, from, options_.limits.tail, metrics));
  }
  if (before.unacknowledged == 0) return;
  LogWarning("alerts may not have reached the server before the last stop",
             {{"alerts", before.unacknowledged}});
  Lose(LossCause::kOutboxShed, before.unacknowledged, clock_->Now().boottime_ns);
}

IdsFeed::~IdsFeed() { Stop(); }

LogOffsets IdsFeed::LoadOffsets() {
  const absl::StatusOr<std::string> text = ReadFile(options_.offsets_file, kOffsetsBytesMax);
  if (absl::IsNotFound(text.status())) return {};
  const absl::StatusOr<LogOffsets> offsets =
      text.ok() ? DecodeLogOffsets(*text) : absl::StatusOr<LogOffsets>(text.status());
  if (offsets.ok()) return *offsets;
  LogError("IDS log positions lost; reading each log from its end",
           {{"file", options_.offsets_file}, {"error", offsets.status().ToString()}});
  Lose(LossCause::kLimit, 1, clock_->Now().boottime_ns);
  return {};
}

void IdsFeed::Lose(LossCause cause, uint64_t count, int64_t now_ns) {
  if (count == 0) return;
  for (Loss& each : losses_) {
    if (each.cause != cause) continue;
    each.count += count;
    each.last_boottime_ns = now_ns;
    return;
  }
  losses_.push_back(
      {.cause = cause, .count = count, .first_boottime_ns = now_ns, .last_boottime_ns = now_ns});
}

// --- Reading

void IdsFeed::OnLine(Log& log, absl::string_view line, int64_t now_ns) {
  IdsLine parsed = ParseIdsLine(log.what.format, line);
  if (parsed.lacks_fields && !std::exchange(log.told_fields, true)) {
    LogError("alerts of Snort 3 lack what rules ask for; set `fields` of its alert_json",
             {{"log", log.what.path}, {"fields", kSnort3FieldsNeeded}});
  }
  if (parsed.kind == IdsLineKind::kNotUnderstood) {
    ++log.nonsense_lines;
  } else if (!line.empty()) {
    log.nonsense_lines = 0;
  }
  switch (parsed.kind) {
    case IdsLineKind::kOther:
      return;
    case IdsLineKind::kNotUnderstood:
      log.not_understood.Increment();
      Lose(LossCause::kUndecodable, 1, now_ns);
      if (!std::exchange(log.told_not_understood, true)) {
        LogWarning("cannot parse a line of an IDS log; further ones are only counted",
                   {{"log", log.what.path},
                    {"format", IdsFormatName(log.what.format)},
                    {"bytes", line.size()}});  // not the line: it may hold what was sent
      }
      return;
    case IdsLineKind::kAlert:
      break;
  }
  log.alerts.Increment();
  const size_t bytes = CostOf(parsed.alert);
  if (queue_.size() >= options_.limits.queued ||
      queued_bytes_ + bytes > options_.limits.queued_bytes) {
    dropped_.Increment();
    Lose(LossCause::kLimit, 1, now_ns);
    return;
  }
  queued_bytes_ += bytes;
  queue_.push_back({.boottime_ns = now_ns,
                    .alert = std::move(parsed.alert),
                    .log = &log,
                    .position = log.tail.line_position()});
}

void IdsFeed::LookAt(Log& log, int64_t now_ns) {
  const LogTailCounters& now = log.tail.counters();
  LogTailCounters& before = log.counted;
  log.too_long.Increment(static_cast<double>(now.too_long - before.too_long));
  log.not_understood.Increment(static_cast<double>(now.cut_off - before.cut_off));
  log.gaps.Increment(static_cast<double>(now.gaps - before.gaps));
  log.truncated.Increment(static_cast<double>(now.truncated - before.truncated));
  Lose(LossCause::kLimit, now.too_long - before.too_long, now_ns);
  Lose(LossCause::kUndecodable, now.cut_off - before.cut_off, now_ns);
  Lose(LossCause::kLimit, now.gaps - before.gaps, now_ns);
  if (now.gaps > before.gaps) {
    LogError(
        "an IDS log was truncated or deleted, perhaps before it was read; how many alerts are "
        "lost is not known",
        {{"log", log.what.path}});
  }
  before = now;
  const absl::Status& status = log.tail.status();
  log.open.Set(status.ok() ? 1 : 0);
  if (status.ok()) {
    log.was_open = true;
    if (std::exchange(log.told_not_open, false)) {
      LogInfo("following an IDS log again", {{"log", log.what.path}});
    }
    log.not_open_since_ns = 0;
    return;
  }
  if (log.not_open_since_ns == 0) log.not_open_since_ns = now_ns;
  if (log.was_open && now_ns - log.not_open_since_ns < kNotOpenNs) return;
  if (std::exchange(log.told_not_open, true)) return;
  LogWarning("cannot read an IDS log; its alerts are not seen",
             {{"log", log.what.path}, {"error", status.ToString()}});
}

std::string IdsFeed::BlindTo(const Log& log, int64_t now_ns) {
  const absl::string_view format = IdsFormatName(log.what.format);
  const bool closed =
      log.not_open_since_ns != 0 && (!log.was_open || now_ns - log.not_open_since_ns >= kNotOpenNs);
  if (closed) {
    return absl::StrCat("IDS log (", format, "): ", log.tail.status().message());
  }
  if (log.nonsense_lines < kNonsenseLines) return "";
  return absl::StrCat("IDS log (", format, "): no line of `", log.what.path,
                      "` makes sense; is its format right?");
}

void IdsFeed::TellBlind(int64_t now_ns) {
  std::vector<std::string> blind;
  for (const auto& log : logs_) {
    if (std::string why = BlindTo(*log, now_ns); !why.empty()) blind.push_back(std::move(why));
  }
  if (blind == blind_told_) return;
  blind_told_ = blind;
  if (sink_.blind) sink_.blind(std::move(blind));
}

// --- Handing over

void IdsFeed::TakeAcknowledged() {
  const uint64_t acknowledged = std::min(sink_.acknowledged(), handed_);
  in_flight_ = handed_ - acknowledged;
}

void IdsFeed::TellLosses() {
  if (losses_.empty()) return;
  sink_.take({}, std::exchange(losses_, {}));
}

void IdsFeed::HandOver(int64_t now_ns) {
  if (queue_.empty() || in_flight_ >= options_.limits.in_flight || !sink_.ready()) return;
  if (last_save_ns_ != 0 && now_ns < last_save_ns_ + options_.limits.save_interval_ns) return;
  const size_t count =
      std::min<size_t>(queue_.size(), options_.limits.in_flight - static_cast<size_t>(in_flight_));
  std::vector<ControlObservation> batch;
  for (size_t i = 0; i < count; ++i) {
    Queued& first = queue_.front();
    queued_bytes_ -= CostOf(first.alert);
    batch.push_back({.boottime_ns = first.boottime_ns, .what = std::move(first.alert)});
    queue_.pop_front();
  }
  handed_ += count;
  in_flight_ += count;
  // First the file: if the process ends in between, they are a loss and not twice there.
  Save(now_ns, in_flight_);
  sink_.take(std::move(batch), {});
}

std::map<std::string, LogPosition> IdsFeed::Positions() const {
  std::map<std::string, LogPosition> positions;
  // What is queued is read again.
  for (const Queued& each : queue_) positions.emplace(each.log->what.path, each.position);
  for (const auto& log : logs_) {
    const std::optional<LogPosition> position = log->tail.position();
    if (position.has_value()) positions.emplace(log->what.path, *position);
  }
  return positions;
}

void IdsFeed::Save(int64_t now_ns, uint64_t unacknowledged) {
  LogOffsets offsets{.logs = Positions(), .unacknowledged = unacknowledged};
  last_save_ns_ = now_ns;
  const absl::Status written =
      WriteFileAtomically(options_.offsets_file, EncodeLogOffsets(offsets));
  unsaved_.Set(written.ok() ? 0 : 1);
  if (written.ok()) {
    saved_ = std::move(offsets);
    told_unsaved_ = false;
    return;
  }
  if (std::exchange(told_unsaved_, true)) return;
  LogError("cannot save IDS log positions; alerts may be reported twice after a crash",
           {{"error", written.ToString()}});
}

void IdsFeed::SaveIfDue(int64_t now_ns) {
  const int64_t age_ns = now_ns - last_save_ns_;
  if (last_save_ns_ == 0 ||
      (in_flight_ != saved_.unacknowledged && age_ns >= kAcknowledgedSaveNs) ||
      (age_ns >= kPositionSaveNs && (told_unsaved_ || Positions() != saved_.logs))) {
    Save(now_ns, in_flight_);
  }
}

bool IdsFeed::Turn() {
  const int64_t now_ns = clock_->Now().boottime_ns;
  bool more = false;
  for (const auto& log : logs_) {
    more |= log->tail.Read(now_ns, [&](absl::string_view line) { OnLine(*log, line, now_ns); });
    LookAt(*log, now_ns);
  }
  TellBlind(now_ns);
  TellLosses();
  TakeAcknowledged();
  HandOver(now_ns);
  SaveIfDue(now_ns);
  return more;
}

// --- The thread

void IdsFeed::Start() {
  thread_ = std::thread([this] { Run(); });
}

void IdsFeed::Stop() {
  if (!thread_.joinable()) return;
  const uint64_t one = 1;
  // Cannot fail: the counter is far from its limit.
  (void)!write(stop_.get(), &one, sizeof(one));
  thread_.join();
  const int64_t deadline_ns = clock_->Now().boottime_ns + kStopNs;
  for (TakeAcknowledged(); in_flight_ > 0 && clock_->Now().boottime_ns < deadline_ns;
       TakeAcknowledged()) {
    if (!sink_.ready()) break;
    absl::SleepFor(absl::Milliseconds(kBusyMs));
  }
  SaveAtEnd();
}

void IdsFeed::SaveAtEnd() {
  TakeAcknowledged();
  Save(clock_->Now().boottime_ns, options_.outbox_survives_stop ? 0 : in_flight_);
}

bool IdsFeed::Wait(int timeout_ms) {
  std::vector<pollfd> events = {{.fd = stop_.get(), .events = POLLIN, .revents = 0}};
  for (const auto& log : logs_) {
    events.push_back({.fd = log->tail.wake_fd(), .events = POLLIN, .revents = 0});
  }
  poll(events.data(), events.size(), timeout_ms);
  if ((events[0].revents & POLLIN) != 0) return false;
  const bool news = std::any_of(events.begin() + 1, events.end(),
                                [](const pollfd& each) { return each.revents != 0; });
  const int64_t rest_ns = last_turn_ns_ + kBusyMs * kNanosPerMilli - clock_->Now().boottime_ns;
  if (!news || rest_ns <= 0) return true;
  // Close behind the last time: let some more come.
  poll(events.data(), 1, static_cast<int>(rest_ns / kNanosPerMilli) + 1);
  return (events[0].revents & POLLIN) == 0;
}

void IdsFeed::Run() {
  bool more = true;
  while (Wait(more ? 0 : queue_.empty() && in_flight_ == 0 ? kIdleMs : kUnderwayMs)) {
    more = Turn();
    last_turn_ns_ = clock_->Now().boottime_ns;
  }
}

}  // namespace rips::sensor
