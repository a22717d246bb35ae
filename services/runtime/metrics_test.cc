#include "services/runtime/metrics.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <string>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/log_writer.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

// The whole answer to one HTTP request to 127.0.0.1:PORT.
std::string Request(absl::string_view address, absl::string_view request) {
  int port = 0;
  EXPECT_TRUE(absl::SimpleAtoi(address.substr(address.rfind(':') + 1), &port));
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<uint16_t>(port));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  EXPECT_EQ(connect(fd, reinterpret_cast<sockaddr*>(&to), sizeof to), 0);
  const std::string text = absl::StrCat(request, " HTTP/1.1\r\nHost: x\r\n\r\n");
  EXPECT_EQ(send(fd, text.data(), text.size(), 0), static_cast<ssize_t>(text.size()));
  std::string answer;
  char buffer[4096];
  for (ssize_t n; (n = recv(fd, buffer, sizeof buffer, 0)) > 0;) answer.append(buffer, n);
  close(fd);
  return answer;
}

TEST(MetricsTest, GivesTheSameMetricForTheSameNameAndLabels) {
  Metrics metrics;
  const Counter r1 = metrics.AddCounter("rips_alerts_total", "Alerts.", {{"robot", "r1"}});
  const Counter r2 = metrics.AddCounter("rips_alerts_total", "Alerts.", {{"robot", "r2"}});
  const Gauge level = metrics.AddGauge("rips_level", "Level.");

  r1.Increment();
  metrics.AddCounter("rips_alerts_total", "Alerts.", {{"robot", "r1"}}).Increment(2);
  level.Set(5);
  level.Add(-1.5);

  EXPECT_EQ(r1.Value(), 3);
  EXPECT_EQ(r2.Value(), 0);
  EXPECT_EQ(level.Value(), 3.5);
  const std::string text = metrics.Text();
  EXPECT_THAT(text, HasSubstr("# TYPE rips_alerts_total counter\n"));
  EXPECT_THAT(text, HasSubstr("rips_alerts_total{robot=\"r1\"} 3\n"));
  EXPECT_THAT(text, HasSubstr("rips_level 3.5\n"));
}

TEST(MetricsTest, ADefaultMadeMetricCountsNothing) {
  const Counter counter;
  const Gauge gauge;
  Histogram().Observe(1);
  GaugeTable().Replace({{{}, 1}});
  counter.Increment();
  gauge.Set(1);
  gauge.Add(1);
  EXPECT_EQ(counter.Value(), 0);
  EXPECT_EQ(gauge.Value(), 0);
}

TEST(MetricsTest, AHistogramCountsByBucket) {
  Metrics metrics;
  const Histogram took = metrics.AddHistogram("rips_took_seconds", "Took.", {0.1, 1});

  took.Observe(0.05);
  took.Observe(0.5);
  took.Observe(50);

  const std::string text = metrics.Text();
  EXPECT_THAT(text, HasSubstr("# TYPE rips_took_seconds histogram\n"));
  EXPECT_THAT(text, HasSubstr("rips_took_seconds_bucket{le=\"0.1\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("rips_took_seconds_bucket{le=\"1\"} 2\n"));
  EXPECT_THAT(text, HasSubstr("rips_took_seconds_bucket{le=\"+Inf\"} 3\n"));
}

TEST(MetricsTest, ATableIsReplacedAsAWhole) {
  Metrics metrics;
  const GaugeTable table = metrics.AddTable("rips_robot_level", "Level.");
  EXPECT_THAT(metrics.Text(), Not(HasSubstr("rips_robot_level")));

  table.Replace({{{{"robot", "r1"}, {"level", "DEFAULT"}}, 1}});
  EXPECT_THAT(metrics.Text(), HasSubstr("# HELP rips_robot_level Level.\n"
                                        "# TYPE rips_robot_level gauge\n"
                                        "rips_robot_level{level=\"DEFAULT\",robot=\"r1\"} 1\n"));
  metrics.AddTable("rips_robot_level", "Level.")
      .Replace({{{{"robot", "r1"}, {"level", "A\"\n\\"}}, 1}});

  EXPECT_THAT(metrics.Text(), Not(HasSubstr("DEFAULT")));
  EXPECT_THAT(metrics.Text(), HasSubstr("{level=\"A\\\"\\n\\\\\",robot=\"r1\"} 1\n")) << "escaped";
  table.Replace({});
  EXPECT_THAT(metrics.Text(), Not(HasSubstr("rips_robot_level")));
}

TEST(MetricsTest, WhatIsNotShownKeepsCounting) {
  Metrics metrics;
  const Counter gone = metrics.AddCounter("rips_x_total", "X.", {{"robot", "gone"}});
  metrics.AddCounter("rips_x_total", "X.", {{"robot", "here"}}).Increment();
  metrics.AddGauge("rips_plain", "Plain.").Set(1);

  metrics.SetShown([](const MetricLabels& labels) { return labels.at("robot") != "gone"; });
  gone.Increment(2);

  EXPECT_THAT(metrics.Text(), Not(HasSubstr("gone")));
  EXPECT_THAT(metrics.Text(), HasSubstr("rips_x_total{robot=\"here\"} 1\n"));
  EXPECT_THAT(metrics.Text(), HasSubstr("rips_plain 1\n")) << "has no labels";
  metrics.SetShown([](const MetricLabels&) { return true; });
  EXPECT_THAT(metrics.Text(), HasSubstr("rips_x_total{robot=\"gone\"} 2\n"));
}

// In a process of its own, whose log is a full pipe.
TEST(MetricsServerTest, CountsDroppedLogLines) {
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  while (TryWriteToLog(ends[1], std::string(4'095, 'x') + "\n")) {
  }
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(ends[1], STDERR_FILENO);
    StartLogWriter();
    Metrics metrics;
    const auto server =
        MetricsServer::Start("127.0.0.1:0", &metrics, [] { return absl::Status(); });
    const std::string before = Request((*server)->address(), "GET /metrics");
    for (int i = 0; i < 10'000; ++i) LogInfo("working");
    const std::string after = Request((*server)->address(), "GET /metrics");
    const std::string expected =
        absl::StrCat("\nrips_log_lines_dropped_total ", LogLinesDropped(), "\n");
    const bool right = before.find("\nrips_log_lines_dropped_total 0\n") != std::string::npos &&
                       after.find(expected) != std::string::npos && LogLinesDropped() > 0;
    _exit(right ? 0 : 1);
  }
  close(ends[1]);
  int status = 0;
  ASSERT_EQ(waitpid(pid, &status, 0), pid);
  EXPECT_EQ(status, 0);
  close(ends[0]);
}

TEST(MetricsServerTest, ServesMetricsHealthAndReadiness) {
  Metrics metrics;
  metrics.AddCounter("rips_x_total", "X.").Increment();
  absl::Status ready = absl::UnavailableError("no rules yet");
  const auto server = MetricsServer::Start("127.0.0.1:0", &metrics, [&] { return ready; });
  ASSERT_THAT(server, IsOk());
  const std::string address = (*server)->address();
  EXPECT_THAT(address, StartsWith("127.0.0.1:"));
  EXPECT_NE(address, "127.0.0.1:0");

  EXPECT_THAT(Request(address, "GET /metrics"), HasSubstr("\r\n\r\n# HELP rips_x_total X.\n"));
  EXPECT_THAT(Request(address, "GET /healthz"), StartsWith("HTTP/1.1 200 "));
  const std::string not_ready = Request(address, "GET /readyz");
  EXPECT_THAT(not_ready, StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(not_ready, HasSubstr("no rules yet\n"));
  ready = absl::OkStatus();
  EXPECT_THAT(Request(address, "GET /readyz"), StartsWith("HTTP/1.1 200 "));
  EXPECT_THAT(Request(address, "GET /etc/passwd"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Request(address, "GET /"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Request(address, "POST /metrics"), StartsWith("HTTP/1.1 405 "));
}

TEST(MetricsServerTest, MayBeOff) {
  Metrics metrics;
  const auto server = MetricsServer::Start("", &metrics, nullptr);
  ASSERT_THAT(server, IsOk());
  EXPECT_EQ((*server)->address(), "");
}

TEST(MetricsServerTest, RefusesBadAndTakenAddresses) {
  Metrics metrics;
  for (const char* bad : {"9464", ":9464", "127.0.0.1:", "127.0.0.1:70000", "127.0.0.1:80,81",
                          "127.0.0.1:80s", "localhost:80"}) {
    EXPECT_THAT(MetricsServer::Start(bad, &metrics, nullptr),
                StatusIs(absl::StatusCode::kInvalidArgument))
        << bad;
  }
  const auto first = MetricsServer::Start("127.0.0.1:0", &metrics, nullptr);
  ASSERT_THAT(first, IsOk());
  EXPECT_THAT(MetricsServer::Start((*first)->address(), &metrics, nullptr),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is the port in use?")));
}

TEST(MetricsServerTest, WarnsOfAnAddressBeyondThisHost) {
  Metrics metrics;
  testing::internal::CaptureStderr();
  EXPECT_THAT(MetricsServer::Start("127.0.0.1:0", &metrics, nullptr), IsOk());
  EXPECT_THAT(testing::internal::GetCapturedStderr(), Not(HasSubstr("beyond this host")));
  testing::internal::CaptureStderr();
  EXPECT_THAT(MetricsServer::Start("0.0.0.0:0", &metrics, nullptr), IsOk());
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("beyond this host"));
}

TEST(MetricsPageTest, ATakenPortIsServedWhenItIsFree) {
  Metrics others;
  auto other = MetricsServer::Start("127.0.0.1:0", &others, nullptr);
  ASSERT_THAT(other, IsOk());
  const std::string address = (*other)->address();
  Metrics metrics;
  std::string told;

  auto page = MetricsPage::Start(
      address, &metrics, nullptr,
      [&](const absl::Status& status) { told = std::string(status.message()); },
      absl::Milliseconds(1));
  ASSERT_THAT(page, IsOk());
  EXPECT_THAT(told, HasSubstr("is the port in use?"));
  EXPECT_EQ((*page)->address(), "");
  other->reset();

  const int64_t deadline_ns = BoottimeAfter(absl::Seconds(60));
  while ((*page)->address().empty() && BoottimeNow() < deadline_ns) std::this_thread::yield();
  ASSERT_EQ((*page)->address(), address);
  EXPECT_THAT(Request(address, "GET /metrics"), HasSubstr("\nrips_metrics_bind_failures_total "));
}

TEST(MetricsPageTest, ABadAddressIsNotWaitedFor) {
  Metrics metrics;
  EXPECT_THAT(MetricsPage::Start("nowhere", &metrics, nullptr),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips
