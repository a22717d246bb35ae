#include "services/runtime/metrics.h"

#include <algorithm>
#include <exception>
#include <utility>

#include "absl/strings/str_cat.h"
#include "prometheus/counter.h"
#include "prometheus/gauge.h"
#include "prometheus/histogram.h"
#include "prometheus/registry.h"
#include "prometheus/text_serializer.h"
#include "services/base/check.h"
#include "services/base/status_macros.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/page_server.h"

namespace rips {
namespace {

constexpr absl::Duration kPageRetryMax = absl::Seconds(30);

bool IsShown(const Metrics::Shown& shown, const prometheus::ClientMetric& metric) {
  if (metric.label.empty()) return true;
  MetricLabels labels;
  for (const auto& label : metric.label) labels.emplace(label.name, label.value);
  return shown(labels);
}

void RemoveHidden(const Metrics::Shown& shown, std::vector<prometheus::MetricFamily>* families) {
  for (prometheus::MetricFamily& family : *families) {
    std::erase_if(family.metric, [&](const auto& metric) { return !IsShown(shown, metric); });
  }
}

}  // namespace

void Counter::Increment(double by) const {
  if (cell_ != nullptr) static_cast<prometheus::Counter*>(cell_)->Increment(by);
}

double Counter::Value() const {
  return cell_ == nullptr ? 0 : static_cast<prometheus::Counter*>(cell_)->Value();
}

void Gauge::Set(double value) const {
  if (cell_ != nullptr) static_cast<prometheus::Gauge*>(cell_)->Set(value);
}

void Gauge::Add(double by) const {
  if (cell_ != nullptr) static_cast<prometheus::Gauge*>(cell_)->Increment(by);
}

double Gauge::Value() const {
  return cell_ == nullptr ? 0 : static_cast<prometheus::Gauge*>(cell_)->Value();
}

void Histogram::Observe(double value) const {
  if (cell_ != nullptr) static_cast<prometheus::Histogram*>(cell_)->Observe(value);
}

// ---------------------------------------------------------------------------------- tables

struct GaugeTable::Cell {
  std::string help;
  Mutex mu;
  std::vector<MetricSample> samples ABSL_GUARDED_BY(mu);
};

void GaugeTable::Replace(std::vector<MetricSample> samples) const {
  if (cell_ == nullptr) return;
  MutexLock lock(&cell_->mu);
  cell_->samples = std::move(samples);
}

struct Metrics::Registry {
  prometheus::Registry registry{prometheus::Registry::InsertBehavior::Merge};
};

Metrics::Metrics() : registry_(std::make_unique<Registry>()) {}
Metrics::~Metrics() = default;

Counter Metrics::AddCounter(const std::string& name, const std::string& help, MetricLabels labels) {
  try {
    return Counter(&prometheus::BuildCounter()
                        .Name(name)
                        .Help(help)
                        .Register(registry_->registry)
                        .Add(labels));
  } catch (const std::exception&) {
    RIPS_CHECK(false, "a metric has a wrong name or two kinds");
  }
}

Gauge Metrics::AddGauge(const std::string& name, const std::string& help, MetricLabels labels) {
  try {
    return Gauge(
        &prometheus::BuildGauge().Name(name).Help(help).Register(registry_->registry).Add(labels));
  } catch (const std::exception&) {
    RIPS_CHECK(false, "a metric has a wrong name or two kinds");
  }
}

Histogram Metrics::AddHistogram(const std::string& name, const std::string& help,
                                const std::vector<double>& bounds, MetricLabels labels) {
  try {
    return Histogram(&prometheus::BuildHistogram()
                          .Name(name)
                          .Help(help)
                          .Register(registry_->registry)
                          .Add(labels, bounds));
  } catch (const std::exception&) {
    RIPS_CHECK(false, "a metric has a wrong name or two kinds");
  }
}

GaugeTable Metrics::AddTable(const std::string& name, const std::string& help) {
  MutexLock lock(&mu_);
  auto& cell = tables_[name];
  if (cell == nullptr) cell = std::make_unique<GaugeTable::Cell>();
  cell->help = help;
  return GaugeTable(cell.get());
}

void Metrics::SetShown(Shown shown) {
  MutexLock lock(&mu_);
  shown_ = std::move(shown);
}

std::string Metrics::Text() const {
  std::vector<prometheus::MetricFamily> families = registry_->registry.Collect();
  MutexLock lock(&mu_);
  if (shown_) RemoveHidden(shown_, &families);
  for (const auto& [name, table] : tables_) {
    prometheus::MetricFamily family{
        .name = name, .help = table->help, .type = prometheus::MetricType::Gauge, .metric = {}};
    MutexLock table_lock(&table->mu);
    for (const MetricSample& sample : table->samples) {
      prometheus::ClientMetric& metric = family.metric.emplace_back();
      for (const auto& [label, value] : sample.labels) metric.label.push_back({label, value});
      metric.gauge.value = sample.value;
    }
    families.push_back(std::move(family));
  }
  std::erase_if(families, [](const auto& family) { return family.metric.empty(); });
  return prometheus::TextSerializer().Serialize(families);
}

MetricsServer::MetricsServer() = default;
MetricsServer::~MetricsServer() = default;

namespace {

constexpr char kDroppedHelp[] =
    "Connections to this page that were closed without an answer, by reason.";

bool QuickPage(const Metrics& metrics, bool has_ready, absl::string_view path, PageAnswer& answer) {
  if (path == "/metrics") {
    answer = {.type = "text/plain; version=0.0.4", .body = metrics.Text()};
  } else if (path == "/healthz") {
    answer.body = "ok\n";
  } else if (path == "/readyz") {
    answer.body = "ready\n";
    return !has_ready;
  } else {
    answer = {.code = 404, .body = "try /metrics, /healthz or /readyz\n"};
  }
  return true;
}

PageAnswer ReadyPage(const MetricsServer::Ready& ready) {
  const absl::Status status = ready();
  if (status.ok()) return {.body = "ready\n"};
  return {.code = 503, .body = absl::StrCat(status.message(), "\n")};
}

}  // namespace

absl::StatusOr<std::unique_ptr<MetricsServer>> MetricsServer::Start(absl::string_view address,
                                                                    Metrics* metrics, Ready ready) {
  std::unique_ptr<MetricsServer> server(new MetricsServer());
  if (address.empty()) return server;
  RIPS_ASSIGN_OR_RETURN(const PageAddress parsed, ParsePageAddress(address));
  const auto counter = [&](const char* reason) {
    return metrics->AddCounter("rips_metrics_connections_dropped_total", kDroppedHelp,
                               {{"reason", reason}});
  };
  const Counter log_dropped = metrics->AddCounter(
      "rips_log_lines_dropped_total", "Log lines that were not written: nothing read the log.");
  PageServer::Pages pages{
      .quick =
          [metrics, has_ready = ready != nullptr, log_dropped](absl::string_view path,
                                                               PageAnswer& answer) {
            // One call at a time.
            log_dropped.Increment(static_cast<double>(LogLinesDropped()) - log_dropped.Value());
            return QuickPage(*metrics, has_ready, path, answer);
          },
      .slow = [ready = std::move(ready)] { return ReadyPage(ready); },
      .dropped =
          [slow = counter("slow"), too_long = counter("long"),
           crowded = counter("crowded")](PageServer::Dropped why) {
            const Counter& count = why == PageServer::Dropped::kSlow   ? slow
                                   : why == PageServer::Dropped::kLong ? too_long
                                                                       : crowded;
            count.Increment();
          }};
  auto started = PageServer::Start(parsed, std::move(pages));
  if (!started.ok()) {
    return absl::UnavailableError(absl::StrCat("cannot serve metrics on `", address, "` (",
                                               started.status().message(),
                                               "); is the port in use?"));
  }
  server->pages_ = *std::move(started);
  server->address_ = absl::StrCat(parsed.host, ":", server->pages_->port());
  if (!parsed.loopback) {
    LogWarning(
        "metrics are served beyond this host, unencrypted and without authentication: they name "
        "robots and topics; use a loopback address, or let only the scraper reach the port",
        {{"address", server->address_}});
  }
  return server;
}

// --- MetricsPage

absl::StatusOr<std::unique_ptr<MetricsPage>> MetricsPage::Start(
    const std::string& address, Metrics* metrics, MetricsServer::Ready ready,
    const std::function<void(const absl::Status&)>& taken, absl::Duration first_delay) {
  std::unique_ptr<MetricsPage> page(new MetricsPage(address, metrics, std::move(ready)));
  page->failures_ = metrics->AddCounter("rips_metrics_bind_failures_total",
                                        "Attempts to serve this page that found its port taken.");
  const absl::Status served = page->TryToServe();
  if (served.ok()) return page;
  if (absl::IsInvalidArgument(served)) return served;
  LogError("cannot serve metrics; retrying", {{"reason", served.message()}});
  if (taken) taken(served);
  page->thread_ = std::thread([page = page.get(), first_delay] { page->Run(first_delay); });
  return page;
}

MetricsPage::~MetricsPage() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    stop_cond_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

std::string MetricsPage::address() const {
  MutexLock lock(&mu_);
  return server_ == nullptr ? "" : server_->address();
}

absl::Status MetricsPage::TryToServe() {
  auto server = MetricsServer::Start(wanted_, metrics_, ready_);
  if (!server.ok()) {
    failures_.Increment();
    return server.status();
  }
  MutexLock lock(&mu_);
  server_ = *std::move(server);
  return absl::OkStatus();
}

void MetricsPage::Run(absl::Duration delay) {
  while (true) {
    {
      MutexLock lock(&mu_);
      while (!stopping_ && stop_cond_.WaitFor(lock, delay)) {
      }
      if (stopping_) return;
    }
    if (TryToServe().ok()) {
      LogInfo("listening", {{"metrics", address()}});
      return;
    }
    delay = std::min(2 * delay, kPageRetryMax);
  }
}

}  // namespace rips
